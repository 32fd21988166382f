"""Stress that depends on how fast a homogeneous test was, and on how long ago (Simo 1987)."""
