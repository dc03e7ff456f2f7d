"""Physics engines behind one protocol, controllers, and replay of logged commands."""
