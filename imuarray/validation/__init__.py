"""Validation of the diagnosis: cases with a sealed truth are diagnosed blindly and are scored at the end.

::

    worlds       random arrays, plans, rooms and recorders, a pure function of a seed; bench: the fixed ones
    plans        the cases of a run, by half, size and seed
    case         one case, and its outcome
    generator    the program that records the cases, which shares no code with the diagnosis
    severity     the severity that amounts to a given number of detection limits in one case
    case_folder  cases from other sources; injections: real recordings as such cases
    trial        one case from its recording to its outcome, in a process of its own
    running      all cases over executors (processes or a Dask cluster); resumable, a lost worker costs its case
    scoring      outcomes against the sealed truth: the figures of each world, each with its bar (score_* are its parts)
    calibration  probabilities of causes, fitted and cross-validated; confusable effects
"""
