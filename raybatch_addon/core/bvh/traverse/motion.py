"""What traversals are made of where instances and vertices move."""

MOTION_HEADERS = ("math/motion.h", "traverse/motion.h")
"""Headers that stand before all others."""
