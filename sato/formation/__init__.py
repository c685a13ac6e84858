"""System 2, formation flying: gains, alignment, auction, control law [Lusk2020].

It plans nothing: a control law and collision avoidance stand in place of planning.
"""
