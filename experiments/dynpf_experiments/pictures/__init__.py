"""What a run looks like: a plain, bounded data structure of a recording, for pages."""
