"""Flight test station: corrected angle of attack and live aerodynamic derivatives at 50 Hz."""
