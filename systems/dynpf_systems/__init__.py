"""The systems: each a folder with all that it brings, and a line here."""

SYSTEMS = ("rooms", "parts", "colon")
