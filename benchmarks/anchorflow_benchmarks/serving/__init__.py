"""What a server does under many callers.

crowd          closed-loop clients with a budget, and a probe that asks for its health meanwhile
lean_callers   the callers of a crowd: requests encoded ahead, answers hardly looked at
micro_batches  throughput with micro-batches over that without
release        how soon an engine is free when nobody waits any more
swaps          bundles swapped while clients ask
kills          processes killed while clients ask
"""
