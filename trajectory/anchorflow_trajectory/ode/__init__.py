"""What a flow's solvers share, in numpy or in torch: the methods as data, and flow time."""
