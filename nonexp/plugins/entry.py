"""Entry point for Mitsuba >= 3.10, which imports this module again at each change of variant."""

from nonexp import plugins

plugins.install()
plugins.register()
