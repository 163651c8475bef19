"""Arguments, progress, exit codes and the only print()."""
