"""What runs beside a robot: trained networks in a control loop, without torch and without a simulator."""
