"""What holds for every test: no claim about time, since machines are slow and busy."""

from hypothesis import settings

settings.register_profile("fieldkit", deadline=None)
settings.load_profile("fieldkit")
