"""Tests for what is left in the residuals of a fit."""
