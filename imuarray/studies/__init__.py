"""Evidence beside the product: the paper recomputed and replicated, what fusion gains, and a demonstration.

Nothing of the product imports these packages; the commands `imuarray paper`, `study` and `demo` do, when they run.
"""
