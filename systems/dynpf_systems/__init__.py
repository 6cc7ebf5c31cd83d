"""The systems: each a folder with all that it brings, nodes, measures and studies, and a name here."""

SYSTEMS = ("rooms", "parts", "colon")
