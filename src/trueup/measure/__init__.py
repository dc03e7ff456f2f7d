"""How large the gap is, with intervals; it does not know who made the simulation."""
