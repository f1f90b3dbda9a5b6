"""The fitted base model with its nuisance populations, and its replicates."""
