"""The Rendered mode of the 3D view, without a window: real depsgraphs and spaces, and regions made up."""
