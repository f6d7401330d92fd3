"""How a subject moves between pictures, and what lies between two moments."""
