"""What is read from files: meshes, touches, lists, images, sensors, priors, configuration."""
