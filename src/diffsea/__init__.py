"""Differentiable simulation, identification and diagnosis of surface vessels."""
