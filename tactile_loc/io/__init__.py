"""Readers and writers of files: meshes, touches, lists, images, sensors, priors, configuration."""
