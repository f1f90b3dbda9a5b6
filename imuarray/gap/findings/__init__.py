"""The findings of a diagnosis: causes with probabilities, closure, verdict, what is not observable, and what to record
next.
"""
