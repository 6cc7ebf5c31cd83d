"""Files: recordings, and the formats of others that become recordings or are made of them."""
