// Sums of two views for `cell_scores.wgsl`.

alias Starts = vec2u;

// Of a row of a window: nine times the means, 81 times both variances and the covariance.
struct Row {
    means: vec2f,
    products: vec3f,  // 00, 11, 01
}

fn starts_of(layer: u32, x: u32, y: u32) -> Starts {
    return Starts(start_of(0u, layer, x, y), start_of(1u, layer, x, y));
}

fn samples_at(at: Starts) -> vec2f {
    return vec2f(samples[at.x], samples[at.y]);
}

// Of differences from the middle, which are small: so their sums are exact.
fn row_sums(middle: Starts) -> Row {
    let light = samples_at(middle);
    let outer = samples_at(middle - 2u * entry_count) - light;
    let inner = samples_at(middle - entry_count) - light;
    let beyond = samples_at(middle + entry_count) - light;
    let last = samples_at(middle + 2u * entry_count) - light;
    let sums = outer + last + 2.0 * (inner + beyond);
    let products = outer.xyx * outer.xyy + last.xyx * last.xyy + 2.0 * (inner.xyx * inner.xyy + beyond.xyx * beyond.xyy);
    return Row(9.0 * light + sums, (8.0 * products + products) - sums.xyx * sums.xyy);
}

// The correlation of rows that are joined to a window. Means count from the whole number next to their mean, so that
// their products are exact; sums above 2^24 are rounded, in the same order as on the CPU.
fn score_of(a: Row, b: Row, c: Row, d: Row, e: Row, floors: vec3f) -> f32 {
    let total = (a.means + e.means + c.means) + 2.0 * (b.means + d.means + c.means);
    let middle = round(total * (1.0 / 9.0));
    let left = total - 9.0 * middle;
    let means_a = a.means - middle;
    let means_b = b.means - middle;
    let means_c = c.means - middle;
    let means_d = d.means - middle;
    let means_e = e.means - middle;
    let ends = a.products + e.products + means_a.xyx * means_a.xyy + means_e.xyx * means_e.xyy;
    let inside = b.products + d.products + means_b.xyx * means_b.xyy + means_d.xyx * means_d.xyy;
    let inmost = c.products + means_c.xyx * means_c.xyy;
    let value = (ends + inmost) + 2.0 * (inside + inmost);
    let joined = (8.0 * value + value) - left.xyx * left.xyy;
    let variances = max(joined.xy, vec2f()) + floors.xy;
    return clamp(joined.z / sqrt(max(variances.x * variances.y, 1.0e-37)), -1.0, 1.0);
}
