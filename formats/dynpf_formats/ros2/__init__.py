"""What live ROS 2 robots say over Zenoh in the format of rmw_zenoh: keys, tokens, attachments, types and messages."""
