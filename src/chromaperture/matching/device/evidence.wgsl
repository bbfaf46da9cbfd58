// Evidence from the blur of pairs of channels.

// ---- pair_spectra: indexing
// Spectra of both channels of every pair, without what is noise in either, smoothed by the finest Gaussian of all bands:
// what P and Q have at all depths alike, divided by the numbers of a tile.

in spectra: array<vec2f>;  // (tiles, 3, span, span / 2 + 1)
in signal_share: array<f32>;  // alike
in low_pass: array<f32>;  // (span,)
out pair_spectra: array<vec4f>;  // (tiles, pairs, span, kept)

const kept = span / 2u;

fn main(i) {
    if (i >= tiles * pair_count * span * kept) { return; }
    let x = i % kept;
    let y = i / kept % span;
    let packed = pairs >> (4u * (i / (kept * span) % pair_count));
    let tile = i / (kept * span * pair_count);
    let at_a = ((tile * 3u + (packed & 3u)) * span + y) * (kept + 1u) + x;
    let at_b = ((tile * 3u + ((packed >> 2u) & 3u)) * span + y) * (kept + 1u) + x;
    let gain = low_pass[y] * low_pass[x] * min(signal_share[at_a], signal_share[at_b]) / f32(span * span);
    pair_spectra[i] = vec4f(spectra[at_a], spectra[at_b]) * gain;
}

// ---- count_up
// Adds 1 to a number: dispatches that are repeated find out which repetition they are.

out number: array<u32>;

@workgroup_size(1)
fn main() {
    number[0] = select(number[0] + 1u, 0u, to_zero);
}

// ---- point_rows
// Point-spread functions from traced rays, and the Fourier transforms of their rows. A workgroup adds the rays of one
// tile, channel and layer to the four pixels around each, as whole numbers in shared memory (`cells` pixels: some rows),
// and transforms those rows at the frequencies that the samples of a tile have: an invocation has four of a row. Pixels on
// both sides of the middle, as far from it, share their waves.

in factors: array<vec2f>;  // (tile_px,)
in rays: array<vec4f>;  // (tiles, channels, points): x, y at infinity, px; light; point
in pupil: array<vec2f>;  // (points,)
in layers: array<vec2f>;  // (layers,): defocus at the pupil's edge, reach, px
in round: array<u32>;
out rows: array<vec4f>;  // (layers of a round, tiles, channels, side, kept / 2)

const fours = (kept + 3u) / 4u;
const ONE = 1073741824.0f;  // 2^30: all light of a point falls into one pixel at the most

var<workgroup> light: array<atomic<u32>, cells>;

@workgroup_size(128)
fn main(group, local) {
    let layer = min(round[0] * layers_of_round + group.z, layer_count - 1u);
    let reach = u32(layers[layer].y);
    let used = 2u * reach + 2u;  // pixels from -reach to reach + 1
    let top = group.y * rows_of_group;
    if (top >= used) { return; }
    let picture = group.x;
    let count = min(rows_of_group, used - top);
    for (var i = local; i < count * side; i += 128u) { atomicStore(&light[i], 0u); }
    workgroupBarrier();
    for (var j = local; j < points; j += 128u) {
        let ray = rays[picture * points + j];
        if (ray.z <= 0.0) { break; }  // nor have those behind it light
        let place = ray.xy - layers[layer].x * pupil[u32(ray.w)];
        let corner = floor(place);
        let share = place - corner;
        let at = vec2i(corner) + i32(reach);
        for (var k = 0u; k < 4u; k++) {
            let pixel = at + vec2i(i32(k & 1u), i32(k >> 1u));
            let row = pixel.y - i32(top);
            if (row >= 0i && row < i32(rows_of_group) && pixel.x >= 0i && pixel.x < i32(used)) {
                let along = select(1.0 - share.x, share.x, (k & 1u) == 1u);
                let down = select(1.0 - share.y, share.y, k > 1u);
                atomicAdd(&light[u32(row) * side + u32(pixel.x)], u32(ray.z * along * down * ONE + 0.5));
            }
        }
    }
    workgroupBarrier();
    for (var i = local; i < count * fours; i += 128u) {
        let frequency = 4u * (i % fours) + vec4u(0u, 1u, 2u, 3u);
        let middle = i / fours * side + reach;
        // The waves from one pixel to the next: a few dozen products keep 1e-6 of them.
        let to = frequency % tile_px;
        let turn_x = vec4f(factors[to.x].x, factors[to.y].x, factors[to.z].x, factors[to.w].x);
        let turn_y = vec4f(factors[to.x].y, factors[to.y].y, factors[to.z].y, factors[to.w].y);
        var cosines = turn_x;
        var sines = turn_y;
        var sums_x = vec4f(f32(atomicLoad(&light[middle])));
        var sums_y = vec4f();
        for (var x = 1u; x <= reach; x++) {
            let right = f32(atomicLoad(&light[middle + x]));
            let left = f32(atomicLoad(&light[middle - x]));
            sums_x += (right + left) * cosines;
            sums_y += (right - left) * sines;
            let next = cosines * turn_x - sines * turn_y;
            sines = cosines * turn_y + sines * turn_x;
            cosines = next;
        }
        let beyond = f32(atomicLoad(&light[middle + reach + 1u]));
        sums_x = (sums_x + beyond * cosines) / ONE;
        sums_y = (sums_y + beyond * sines) / ONE;
        let first = (((group.z * pictures) + picture) * side + top + i / fours) * (kept / 2u) + 2u * (i % fours);
        rows[first] = vec4f(sums_x.x, sums_y.x, sums_x.y, sums_y.y);
        if (frequency.z < kept) { rows[first + 1u] = vec4f(sums_x.z, sums_y.z, sums_x.w, sums_y.w); }
    }
}

// ---- point_columns
// Transfer functions: the transforms of `point_rows` along the columns, of frequencies and their negatives at once.
// An invocation has two columns at four frequencies, which share what is read. Rows on both sides of the middle, as far
// from it, share their waves.

in factors: array<vec2f>;  // (tile_px,)
in layers: array<vec2f>;
in round: array<u32>;
in rows: array<vec4f>;  // (layers of a round, tiles, channels, side, kept / 2)
out transfers: array<vec4f>;  // (..., size, kept / 2)

const fours = (kept + 3u) / 4u;
const twos = kept / 2u;

// Sums of a column's numbers times cosines, and times sines and the imaginary unit.
struct Waves { cosines_x: vec4f, cosines_y: vec4f, sines_x: vec4f, sines_y: vec4f }

// The sum of two numbers as far from the middle on either side, and their difference.
fn add(sums: ptr<function, Waves>, even: vec2f, odd: vec2f, cosines: vec4f, sines: vec4f) {
    (*sums).cosines_x += even.x * cosines;
    (*sums).cosines_y += even.y * cosines;
    (*sums).sines_x -= odd.y * sines;
    (*sums).sines_y += odd.x * sines;
}

fn main(group, local) {
    let i = group.x * 64u + local;
    if (i >= twos * fours) { return; }
    let layer = min(round[0] * layers_of_round + group.z, layer_count - 1u);
    let reach = u32(layers[layer].y);
    let x = i % twos;
    let y = 4u * (i / twos) + vec4u(0u, 1u, 2u, 3u);
    let picture = group.z * pictures + group.y;
    // The waves from one row to the next: a few dozen products keep 1e-6 of them.
    let to = y % tile_px;
    let turn_x = vec4f(factors[to.x].x, factors[to.y].x, factors[to.z].x, factors[to.w].x);
    let turn_y = vec4f(factors[to.x].y, factors[to.y].y, factors[to.z].y, factors[to.w].y);
    var cosines = turn_x;
    var sines = turn_y;
    let middle = (picture * side + reach) * twos + x;
    let centre = rows[middle];
    var left = Waves(vec4f(centre.x), vec4f(centre.y), vec4f(), vec4f());
    var right = Waves(vec4f(centre.z), vec4f(centre.w), vec4f(), vec4f());
    for (var row = 1u; row <= reach; row++) {
        let after = rows[middle + row * twos];
        let before = rows[middle - row * twos];
        let even = after + before;
        let odd = after - before;
        add(&left, even.xy, odd.xy, cosines, sines);
        add(&right, even.zw, odd.zw, cosines, sines);
        let next = cosines * turn_x - sines * turn_y;
        sines = cosines * turn_y + sines * turn_x;
        cosines = next;
    }
    let beyond = rows[middle + (reach + 1u) * twos];
    add(&left, beyond.xy, beyond.xy, cosines, sines);
    add(&right, beyond.zw, beyond.zw, cosines, sines);
    let first = picture * size * twos + x;
    for (var n = 0u; n < 4u; n++) {
        if (y[n] < kept) {
            let even = vec4f(left.cosines_x[n], left.cosines_y[n], right.cosines_x[n], right.cosines_y[n]);
            let odd = vec4f(left.sines_x[n], left.sines_y[n], right.sines_x[n], right.sines_y[n]);
            transfers[first + y[n] * twos] = even + odd;
            if (y[n] > 0u) { transfers[first + (size - y[n]) * twos] = even - odd; }
        }
    }
}

// ---- tiles_joined: indexing
// P and Q of the frame: the tiles of the four nodes around a sample, weighted by how near they are.

in views: array<vec2f>;  // (layers of a round, tiles, pairs, middle, middle)
// (w, 4) and (h, 4): first node, sample in its tile, its weight, the next one's
in across: array<vec4f>;
in down: array<vec4f>;
in starts: array<f32>;  // (node columns + node rows): first sample of a tile
out joined: array<vec2f>;  // (layers of a round, pairs, h, w)

fn main(i) {
    if (i >= layers_of_round * pair_count * width * height) { return; }
    let x = i % width;
    let y = i / width % height;
    let pair = i / (width * height) % pair_count;
    let layer = i / (width * height * pair_count);
    let u = across[x];
    let v = down[y];
    var sum = vec2f();
    for (var k = 0u; k < 4u; k++) {
        let column = u32(u.x) + (k & 1u);
        let row = u32(v.x) + (k >> 1u);
        let weight = select(u.z, u.w, (k & 1u) == 1u) * select(v.z, v.w, k > 1u);
        if (weight > 0.0) {
            let tile = row * node_columns + column;
            let place = vec2u(u32(f32(x) - starts[column]), u32(f32(y) - starts[node_columns + row]));
            let at = ((layer * tiles + tile) * pair_count + pair) * middle * middle + place.y * middle + place.x;
            sum += weight * views[at];
        }
    }
    joined[i] = sum;
}

// ---- eight_sums
// Sums of a filter of P and Q at eight neighbours, whose pixels overlap: the first four and the others, and the weights of
// what is read.

struct Sums { near: vec4f, far: vec4f, near_p: vec4f, far_p: vec4f, near_q: vec4f, far_q: vec4f }

fn added(sums: Sums, tap: f32, here: vec2f) -> Sums {
    var next = sums;
    next.far = vec4f(sums.near.w, sums.far.xyz);
    next.near = vec4f(tap, sums.near.xyz);
    next.near_p += next.near * here.x;
    next.far_p += next.far * here.x;
    next.near_q += next.near * here.y;
    next.far_q += next.far * here.y;
    return next;
}

// ---- bands_rows: indexing, eight_sums
// All Gaussians of the bands along the rows of P and Q. An invocation has eight neighbours, whose pixels overlap.

in joined: array<vec2f>;  // (pictures, h, w)
in taps: array<f32>;  // (2 reach + 8, smooths): seven zeros at the end
out smooth_rows: array<vec2f>;  // (smooths, pictures, h, w)

const eights = (width + 7u) / 8u;

fn main(i) {
    if (i >= pictures * height * eights) { return; }
    let x = 8u * (i % eights);
    let row = i / eights * width;
    var sums: array<Sums, smooths>;
    for (var k = 0u; k < 2u * reach + 8u; k++) {
        let here = joined[row + mirrored(i32(x + k) - i32(reach), width)];
        for (var s = 0u; s < smooths; s++) { sums[s] = added(sums[s], taps[k * smooths + s], here); }
    }
    for (var s = 0u; s < smooths; s++) {
        let first = s * pictures * height * width + row + x;
        for (var n = 0u; n < 4u; n++) {
            if (x + n < width) { smooth_rows[first + n] = vec2f(sums[s].near_p[n], sums[s].near_q[n]); }
            if (x + n + 4u < width) { smooth_rows[first + n + 4u] = vec2f(sums[s].far_p[n], sums[s].far_q[n]); }
        }
    }
}

// ---- bands_columns: indexing, eight_sums
// All Gaussians of the bands along the columns, and their differences: the bands of P and Q. An invocation has eight
// neighbours, whose pixels overlap. The finest Gaussian is that of P and Q themselves: number 0.

in joined: array<vec2f>;  // (pictures, h, w)
in smooth_rows: array<vec2f>;  // (smooths, pictures, h, w)
in taps: array<f32>;  // (2 reach + 8, smooths)
out band_views: array<vec2f>;  // (bands, pictures, h, w)

const eights = (height + 7u) / 8u;
const size = pictures * height * width;

fn main(i) {
    if (i >= pictures * eights * width) { return; }
    let y = 8u * (i / width % eights);
    let first = i / (width * eights) * width * height + i % width;
    var sums: array<Sums, smooths + 1u>;
    for (var n = 0u; n < 4u; n++) {
        let near = joined[first + min(y + n, height - 1u) * width];
        let far = joined[first + min(y + n + 4u, height - 1u) * width];
        sums[0].near_p[n] = near.x;
        sums[0].near_q[n] = near.y;
        sums[0].far_p[n] = far.x;
        sums[0].far_q[n] = far.y;
    }
    for (var k = 0u; k < 2u * reach + 8u; k++) {
        let at = first + mirrored(i32(y + k) - i32(reach), height) * width;
        for (var s = 0u; s < smooths; s++) {
            sums[s + 1u] = added(sums[s + 1u], taps[k * smooths + s], smooth_rows[s * size + at]);
        }
    }
    for (var band = 0u; band < bands; band++) {
        let a = sums[(fine >> (4u * band)) & 15u];
        let b = sums[(coarse >> (4u * band)) & 15u];
        let to = band * size + first + y * width;
        for (var n = 0u; n < 4u; n++) {
            if (y + n < height) { band_views[to + n * width] = vec2f(a.near_p[n] - b.near_p[n], a.near_q[n] - b.near_q[n]); }
            if (y + n + 4u < height) {
                band_views[to + (n + 4u) * width] = vec2f(a.far_p[n] - b.far_p[n], a.far_q[n] - b.far_q[n]);
            }
        }
    }
}

// ---- band_products: indexing
// Products of P and Q, halved by the filter 1 4 6 4 1 along both axes (OpenCV's pyrDown): every second sample. An
// invocation has four samples below each other, whose windows overlap.

in band_views: array<vec2f>;  // (planes, h, w)
out products: array<f32>;  // (planes, ceil(h / 2), ceil(w / 2), 3)

const small_width = (width + 1u) / 2u;
const small_height = (height + 1u) / 2u;
const fours = (small_height + 3u) / 4u;

fn main(i) {
    if (i >= planes * small_width * fours) { return; }
    let x = i % small_width;
    let y = 4u * (i / small_width % fours);
    let plane = i / (small_width * fours);
    let taps = vec3f(0.0625, 0.25, 0.375);
    var sums: array<vec3f, 4>;
    for (var j = 0u; j < 11u; j++) {
        let row = (plane * height + mirrored(i32(2u * y + j) - 2i, height)) * width;
        var along = vec3f();
        for (var k = 0u; k < 5u; k++) {
            let here = band_views[row + mirrored(i32(2u * x + k) - 2i, width)];
            along += taps[min(k, 4u - k)] * vec3f(here.x * here.y, here * here);
        }
        for (var n = 0u; n < 4u; n++) {
            if (j >= 2u * n && j <= 2u * n + 4u) { sums[n] += taps[min(j - 2u * n, 2u * n + 4u - j)] * along; }
        }
    }
    for (var n = 0u; n < min(4u, small_height - y); n++) {
        let to = 3u * ((plane * small_height + y + n) * small_width + x);
        products[to] = sums[n].x;
        products[to + 1u] = sums[n].y;
        products[to + 2u] = sums[n].z;
    }
}

// ---- band_powers: indexing
// Powers of P and Q in windows, from their averaged products.

in products: array<f32>;  // (windows, 3)
out powers: array<vec2f>;  // (windows,)

fn main(i) {
    if (i < windows) { powers[i] = vec2f(products[3u * i + 1u], products[3u * i + 2u]); }
}

// ---- correlations
// Where the correlations of all layers are: of primary pairs (pairs, bands, samples, computed), then of secondary pairs
// (pairs, bands, samples, of_all_pairs), which have the first layers only.

fn correlations_of(pair: u32, band: u32, samples: u32, sample: u32) -> u32 {
    let place = ((pair * bands + band) * samples + sample) * computed;
    if (pair < primary_pairs) { return place; }
    return primary_pairs * bands * samples * computed + (((pair - primary_pairs) * bands + band) * samples + sample) * of_all_pairs;
}

// ---- band_correlation: indexing, correlations
// Correlation of P and Q in windows, from their averaged products. Detail that blur brings from elsewhere is taken off.

in products: array<f32>;  // (bands, layers of a round, pairs, h, w, 3)
in seen: array<vec2f>;  // (bands, all pairs, h, w): powers in focus
in round: array<u32>;
out correlation: array<f32>;  // see `correlations`

fn main(i) {
    if (i >= bands * layers_of_round * pair_count * width * height) { return; }
    let pixel = i % (width * height);
    let pair = i / (width * height) % pair_count;
    let layer = first_layer + round[0] * layers_of_round + i / (width * height * pair_count) % layers_of_round;
    let band = i / (width * height * pair_count * layers_of_round);
    let x = pixel % width;
    let y = pixel / width;
    if (layer >= layer_count || x >= kept_width || y >= kept_height) { return; }
    let powers = vec2f(products[3u * i + 1u], products[3u * i + 2u]);
    var found = products[3u * i] * inverseSqrt(powers.x * powers.y + least_power);
    if (takes_off != 0u) {
        let own = seen[(band * all_pairs + pair) * width * height + pixel];
        let growth = max(vec2f(1.0), powers / (allowed_growth * (own + least_seen)));
        found /= growth.x * growth.y;
    }
    correlation[correlations_of(pair, band, kept_width * kept_height, y * kept_width + x) + layer] = found;
}

// ---- pair_evidence: correlations
// What all pairs and bands of a sample earn at every layer, as the unexplained fraction exp(-2 l / factors), in which
// `labels_read` interpolates. A workgroup has one sample. See `blur.py`.

in correlation: array<f32>;  // see `correlations`
// (count,): where a layer's correlation is; odd ones may lie between even ones: -1
in places: array<i32>;
out unexplained: array<f32>;  // (samples, count)

const evens = (count + 1u) / 2u;
const fourths = (evens + 1u) / 2u;
const primary_lists = primary_pairs * bands;
const lists = pairs * bands;
const first_few = lists * (evens + 4u);
const is_primary = vec3f(f32(primary_pairs > 0u), f32(primary_pairs > 1u), f32(primary_pairs > 2u));
const chunks = (count + 63u) / 64u;

// Every second layer of all pairs' bands, then every fourth of those of secondary pairs: lists between two numbers
// to either side that continue them.
var<workgroup> ladder: array<f32, first_few + (lists - primary_lists) * (fourths + 4u)>;
var<workgroup> most: array<f32, 64>;

fn seconds_of(list: u32) -> u32 {
    return list * (evens + 4u) + 2u;
}

fn fourths_of(list: u32) -> u32 {
    return first_few + (list - primary_lists) * (fourths + 4u) + 2u;
}

// An odd continuation, by the nearer number (0) or the further one (1) at either end.
fn continue_list(first: u32, length: u32, further: u32) {
    let away = min(further + 1u, length - 1u);
    let last = first + length - 1u;
    ladder[first - 1u - further] = 2.0 * ladder[first] - ladder[first + away];
    ladder[last + 1u + further] = 2.0 * ladder[last] - ladder[last - away];
}

// Half way to the next number of a list, by a polynomial through six.
fn halfway(at: u32) -> f32 {
    let inner = ladder[at] + ladder[at + 1u];
    let near = ladder[at - 1u] + ladder[at + 2u];
    return (3.0 * (ladder[at - 2u] + ladder[at + 3u]) - 25.0 * near + 150.0 * inner) / 256.0;
}

// Secondary pairs change half as fast with the layer: they count at every fourth, and at the last.
fn fill_lists(sample: u32, local: u32) {
    for (var i = local; i < primary_lists * evens; i += 64u) {
        let k = i % evens;
        let first = correlations_of(i / evens / bands, i / evens % bands, samples, sample);
        ladder[seconds_of(i / evens) + k] = correlation[first + u32(places[2u * k])];
    }
    for (var i = primary_lists * fourths + local; i < lists * fourths; i += 64u) {
        let first = correlations_of(i / fourths / bands, i / fourths % bands, samples, sample);
        ladder[fourths_of(i / fourths) + i % fourths] = correlation[first + i % fourths];
    }
    workgroupBarrier();
    for (var i = 2u * primary_lists + local; i < 2u * lists; i += 64u) {
        continue_list(fourths_of(i / 2u), fourths, i % 2u);
    }
    workgroupBarrier();
    for (var i = primary_lists * evens + local; i < lists * evens; i += 64u) {
        let list = i / evens;
        let k = i % evens;
        let at = fourths_of(list) + k / 2u;
        var value = ladder[at];
        if (k == evens - 1u && k % 2u == 1u) {
            value = correlation[correlations_of(list / bands, list % bands, samples, sample) + fourths];
        } else if (k % 2u == 1u) {
            value = halfway(at);
        }
        ladder[seconds_of(list) + k] = value;
    }
    workgroupBarrier();
    for (var i = local; i < 2u * lists; i += 64u) { continue_list(seconds_of(i / 2u), evens, i % 2u); }
    workgroupBarrier();
}

// The correlation of a pair in a band at a layer, or what lies between those of its neighbours.
fn correlation_at(pair: u32, band: u32, layer: u32, place: i32, sample: u32) -> f32 {
    let list = pair * bands + band;
    let at = seconds_of(list) + layer / 2u;
    if (layer % 2u == 0u) { return ladder[at]; }
    if (place >= 0i && pair < primary_pairs) {
        return correlation[correlations_of(pair, band, samples, sample) + u32(place)];
    }
    return halfway(at);
}

// `blur_evidence.explained_variance`: a negative correlation counts as far as the product of the other two is negative.
// That product is 0 where there are fewer than three pairs.
fn explained_variance(rho: vec3f) -> vec3f {
    let contrary = clamp(rho.yzx * rho.zxy / -contrary_product, vec3f(), vec3f(1.0));
    let counted = select(vec3f(1.0), contrary, rho < vec3f());
    return min(counted * rho * rho, vec3f(most_correlation2));
}

fn main(group, groups, local) {
    let sample = group.x + group.y * groups.x;
    if (sample >= samples) { return; }
    fill_lists(sample, local);
    var earned: array<vec2f, chunks>;  // of primary and of secondary pairs
    var best = 0.0;  // no log-likelihood is below 0
    for (var chunk = 0u; chunk < chunks; chunk++) {
        let layer = min(64u * chunk + local, count - 1u);
        let place = places[layer];
        var sums = vec2f();
        for (var band = 0u; band < bands; band++) {  // unrolled
            var rho = vec3f();  // of a pair each: there are three at most
            for (var pair = 0u; pair < pairs; pair++) {  // unrolled
                rho[pair] = correlation_at(pair, band, layer, place, sample);
            }
            let nats = -0.5 * weights[band] * log(1.0 - explained_variance(rho));
            sums += vec2f(dot(nats, is_primary), dot(nats, vec3f(1.0) - is_primary));
        }
        earned[chunk] = sums / max(vec2f(1.0), vec2f(f32(primary_pairs), f32(pairs - primary_pairs)));
        best = max(best, earned[chunk].x);
    }
    most[local] = best;
    workgroupBarrier();
    for (var half = 32u; half > 0u; half /= 2u) {
        if (local < half) { most[local] = max(most[local], most[local + half]); }
        workgroupBarrier();
    }
    let weight = fallback_weight * exp(-most[0] / fallback_nats);
    for (var chunk = 0u; chunk < chunks; chunk++) {
        let layer = 64u * chunk + local;
        if (layer < count) {
            unexplained[sample * count + layer] = exp(-2.0 / factors * (earned[chunk].x + weight * earned[chunk].y));
        }
    }
}
