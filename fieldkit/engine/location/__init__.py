"""Where the sources of a whole log are: readings taken together, in metres, without a grid that promises anything."""
