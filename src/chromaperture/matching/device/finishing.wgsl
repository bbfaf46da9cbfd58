// The last of a method's own stages: limits of the error bar, the bar where two views are lacking, confidence.

// Disparity, sigma and confidence of a pixel as they are read on the CPU.
fn finished(i: u32, disparity: f32, sigma: f32, peak: f32, least_sigma: f32) -> vec3u {
    if (!is_known(disparity)) { return vec3u(NAN_BITS, NAN_BITS, 0u); }
    let wide = max(min(sigma, max_sigma_px), least_sigma);
    let confidence = exp(-wide / confidence_scale_px) * clamp(peak, 0.0, 1.0);
    return vec3u(bitcast<u32>(disparity), bitcast<u32>(wide), bitcast<u32>(confidence));
}
