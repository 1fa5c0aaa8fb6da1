"""What planning has to know of the shared errors, by their names."""

from __future__ import annotations

# Shared errors that average down over takes of background and standard.
AVERAGED = ("lamp, standard", "lamp, background", "lamp, background 2")
# Shared errors that are the same whatever the seed of a simulation: they bias, and do not scatter.
CONSTANT = ("mapping", "source cone", "room light", "standard, shape")

DOME = "dome slope"  # how the names of the terms for slope errors begin
