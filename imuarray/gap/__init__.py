"""How a simulation differs from a recording: both are summarised alike, and probes make numbers of the summaries."""
