"""Cars that follow plans: how they move, how it feels, and what it is worth among others.

tracking    the rollout of a plan by a controller
comfort     whether passengers find it comfortable
foresight   what a plan is worth among others who may go several ways
"""
