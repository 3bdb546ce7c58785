"""Cars that follow plans: how they move, how it feels, and what it is worth among others.

tracking    the rollout of a plan by a controller
comfort     whether passengers find it comfortable
course      polylines by arc length, to drive along
following   drives along a course behind whoever is ahead
by_rule     where others may go by rule
foresight   what a plan is worth among others who may go several ways
careful     careful drives among others who are foreseen, and a reference of progress
"""
