"""What Rerun reads of files: `python viewer_side.py FILE...`, with its package on PYTHONPATH.

Prints {file: {entity: {component: number of rows}}}, and of plots, as "values", the last of each.
"""

import json
import sys
from collections import defaultdict
from typing import Any

from rerun.chunk import McapReader, RrdReader


def read(path: str) -> dict[str, dict[str, Any]]:
    """Return the rows of each component of each entity."""
    reader = McapReader(path) if path.endswith(".mcap") else RrdReader(path)
    found: dict[str, dict[str, Any]] = defaultdict(lambda: defaultdict(int))
    for chunk in reader.stream():
        batch = chunk.to_record_batch()
        for name in batch.schema.names:
            if ":" in name:
                found[chunk.entity_path][name] += batch.num_rows
            if name == "Scalars:scalars":
                found[chunk.entity_path]["values"] = batch.column(name)[-1].as_py()
    return found


if __name__ == "__main__":
    print(json.dumps({path: read(path) for path in sys.argv[1:]}))
