"""The base model that is fitted to a recording, the populations of its nuisance quantities, and its replicates."""
