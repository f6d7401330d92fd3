"""What follows from a surface and what it takes: depth, the camera's rays, who sees which light, bounced light."""
