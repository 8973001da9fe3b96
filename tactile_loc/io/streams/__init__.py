"""Streams of images: cameras, videos, recordings and ROS messages."""
