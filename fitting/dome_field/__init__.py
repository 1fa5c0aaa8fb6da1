"""Material and slope errors of the dome together, from the samples of ordinary sessions."""
