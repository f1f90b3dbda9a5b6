"""The check of the diagnosis: cases whose truth is sealed, diagnosed blindly, scored when all is done.

::

    plans       which cases there are, by half, size and seed; limits: how much of a mechanism just shows
    case        one of them, and what came of it
    generator   the program that records them, which shares no code with the diagnosis
    trial       one case from its recording to its outcome, in a process of its own
    running     all of them over executors: processes or a Dask cluster; resumable, a lost worker costs its case
    scoring     outcomes against the sealed truth: the figures, each with its bar (score_* are its parts)
    detection   how the limits were measured
"""
