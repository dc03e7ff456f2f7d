"""Self-contained HTML from saved results; needs neither MuJoCo nor torch."""
