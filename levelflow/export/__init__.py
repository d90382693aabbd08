"""What a field leaves behind: meshes, pictures, reports."""
