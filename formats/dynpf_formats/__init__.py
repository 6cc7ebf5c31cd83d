"""Files: recordings, and the importers and exporters of foreign formats."""
