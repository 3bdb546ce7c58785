"""Several processes that answer on one listening socket, and the one that looks after them.

link        what a supervisor and a worker say to each other
worker      the server of a worker
process     a worker as its supervisor sees it
supervisor  starts workers, replaces those that die, lets all of them go
"""
