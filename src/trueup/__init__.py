"""True up your simulator to your robot."""
