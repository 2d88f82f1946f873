"""The version: what changes in it is in CHANGELOG.md."""

__version__ = "0.2.0.dev0"
