"""The live page: a mission in a browser, offline, on a phone too; and the same page over a recording."""
