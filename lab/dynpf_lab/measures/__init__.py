"""What a recorded run is worth: the estimate against the truth."""
