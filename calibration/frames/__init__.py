"""Counts to rates, and Ward's eq. (2)."""
