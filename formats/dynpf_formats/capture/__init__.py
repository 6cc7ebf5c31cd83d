"""Captures: MCAP files of what was heard on any keys of Zenoh, with an account of what is not in them."""
