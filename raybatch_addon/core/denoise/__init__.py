"""Denoising after a render: pictures and guiding passes as arrays, through the library Open Image Denoise."""
