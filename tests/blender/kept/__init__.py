"""What exports keep of earlier ones, and find again."""
