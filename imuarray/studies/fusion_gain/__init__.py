"""Gain of fusion: the error of every technique on simulated experiments of the paper's array, compared with the simple
average and with the Cramer-Rao bound of the true model (the future work of the paper's section 8).
"""
