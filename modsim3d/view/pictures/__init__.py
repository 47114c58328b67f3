"""Pictures of a camera's image: boxes, silhouettes and ID maps, and sheets of them."""
