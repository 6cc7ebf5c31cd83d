"""What travels between the processes: message types, the topic table, codec, envelope and journal."""
