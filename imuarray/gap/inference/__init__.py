"""Where the recording leaves the model, and which hypotheses explain it; `effects` has one file for each effect."""
