"""Live: the stream of the logger while it runs, the state estimated from it, and its views."""
