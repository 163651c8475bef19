"""Many sessions: find them, run each in a process of its own, here or on a cluster, and tell what came out."""
