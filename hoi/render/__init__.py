"""Pictures of Gaussians: cameras, the differentiable rasteriser, replay of a record, videos."""
