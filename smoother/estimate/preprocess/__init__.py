"""What is done with the streams of a session before anything is estimated."""
