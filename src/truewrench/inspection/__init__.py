"""What is in a log or a recording."""
