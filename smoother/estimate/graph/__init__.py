"""What is left of the first edition: the chains of the paths through fixes alone, and the output until it is ported."""
