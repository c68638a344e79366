"""The equations that measured flight is held against: motion, air, instruments and what they may be wrong by."""
