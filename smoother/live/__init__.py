"""Live: the stream of the logger while it runs, what it says of the box, and how that is shown."""
