"""What a simulated flight gives beyond the signals: what no sensor shows."""

from __future__ import annotations

from typing import Final

TRUTH: Final = ("alpha", "alpha_inertial", "alpha_gust", "w_gust", "u_gust", "CL", "Cm", "elevator_drive", "az_boom",
    "alpha_vane_2",
)  # fmt: skip
"""Angle of attack at the CG and its parts from motion and gust (rad), the gust at the CG (m/s, updraught and headwind
positive), the aerodynamic coefficients about the CG, the angle (rad) that drives the elevator's surface through its
backlash: where the sensor is; the specific force down (m/s2) at the boom's tip; and what the profile's second vane
shows (rad), NaN without one."""
LATERAL_TRUTH: Final = ("beta", "CY", "Cl", "Cn", "v_gust", "p_gust", "r_gust", "beta_fin")
"""Sideslip at the CG, rad, the lateral coefficients, the gust at the CG from the right, m/s, gusts as rates of roll and
yaw, rad/s, and the fin's sideslip where it is flown apart, rad."""
