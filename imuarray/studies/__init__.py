"""Studies with the product: the paper recomputed and replicated, the gain of fusion, and a demonstration.

The product does not import these packages; the commands `imuarray paper`, `study` and `demo` do, when they run.
"""
