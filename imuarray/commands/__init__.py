"""The commands: each module reads its arguments, calls the library, and prints. At its top it imports only click and
modules that need no NumPy, so that a command starts fast.
"""
