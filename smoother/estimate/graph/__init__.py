"""The first edition's engine, as far as it is still used; `model`, `factors` and `solvers` replace it."""
