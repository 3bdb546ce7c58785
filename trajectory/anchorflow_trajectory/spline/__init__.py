"""B-splines with fixed ends: the basis, and the loops that sample it."""
