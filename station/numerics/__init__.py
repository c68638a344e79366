"""One formula each, for all who estimate: pure, without clock, file or row.

The simulation has its own: an estimator that shared the simulator's formulas would prove nothing, so that lever arm,
indicial response and vane are written twice on purpose, forward and inverse. Only the standard atmosphere and the
constants of station.conventions are common to both.
"""
