"""What skin and other surfaces reflect, and how they look under lights that somebody chooses."""
