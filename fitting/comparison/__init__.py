"""Which of several models describes the samples best."""
