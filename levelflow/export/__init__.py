"""What a field leaves behind: meshes, pictures, reports, and files for other programs."""
