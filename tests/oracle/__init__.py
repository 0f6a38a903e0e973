"""Textbook simulator of surface vessels on numpy and scipy: the reference of the tests."""
