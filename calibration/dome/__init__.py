"""Where the pixels look in the dome: eq. (3), the exact mirror and its alignment."""
