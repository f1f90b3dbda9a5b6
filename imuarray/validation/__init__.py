"""The check of the diagnosis: cases whose truth is sealed, diagnosed blindly, scored when all is done.

::

    worlds       random arrays, plans, rooms and recorders, a pure function of a seed; bench: the fixed ones
    plans        which cases there are, by half, size and seed
    case         one of them, and what came of it
    generator    the program that records them, which shares no code with the diagnosis
    severity     how much of an effect is so many detection limits in the very case
    case_folder  cases that somebody else wrote; injections: real recordings as such cases
    trial        one case from its recording to its outcome, in a process of its own
    running      all of them over executors: processes or a Dask cluster; resumable, a lost worker costs its case
    scoring      outcomes against the sealed truth: the figures of each world, each with its bar (score_* are its parts)
    calibration  rates of being right, fitted and cross-validated; which effects are confused
"""
