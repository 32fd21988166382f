"""Contact with rigid surfaces without penalties: collocation, friction and adhesion."""
