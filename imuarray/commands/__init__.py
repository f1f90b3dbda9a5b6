"""The commands: each file reads its arguments, calls the library, and prints. Only click is imported at the top of
them.
"""
