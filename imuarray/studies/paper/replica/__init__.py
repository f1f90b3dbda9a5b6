"""The paper's experiments on the simulated array: does the model reproduce the tables to which it was fitted?

`observe` simulates every experiment of section 4, and `compare` compares each printed statistic with its simulated
value; columns with the same number in another unit (mg, dps) are compared once. No statistic is omitted because it does
not agree.
"""
