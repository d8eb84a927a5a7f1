"""Images: what they hold, their files, comparing, merging and denoising them."""
