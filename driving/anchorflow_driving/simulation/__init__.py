"""Simulated driving: road nets by netgenerate, traffic by SUMO, logs of both.

Needs the extra `[driving]`. Right-hand traffic drives on the net as SUMO has it, left-hand traffic
on its mirror image.
"""
