"""The protocol between processes: message types, topic table, codec, envelope and journal."""
