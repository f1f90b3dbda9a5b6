"""The base model fitted to a recording, the populations of its nuisance quantities, and its replicates."""
