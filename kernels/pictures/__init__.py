"""What is done to pictures before anything is known of light: resampling, noise, blurs, where the subject is, which belong together."""
