"""What a scene would be rendered without, told before the render, and settings of other engines that are taken over."""
