"""What is reported: causes with probabilities, closure, verdict, what cannot be told, what to record next."""
