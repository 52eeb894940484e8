"""What a person looks at in three dimensions: clouds by part, tracks, the axis, playback."""
