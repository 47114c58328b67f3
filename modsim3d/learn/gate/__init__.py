"""What the matching rule does to what is learned."""
