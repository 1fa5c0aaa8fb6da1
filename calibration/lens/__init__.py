"""The fisheye lens and its calibration from photographs."""
