"""Pictures of surfaces, without a GPU or a display."""
