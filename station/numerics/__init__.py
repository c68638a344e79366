"""What several wings compute alike, each once. Pure: no clock, file or row."""
