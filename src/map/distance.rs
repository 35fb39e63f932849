//! Exact Euclidean distance transform of a grid, in linear time (Felzenszwalb and Huttenlocher, 2012).

/// Distance from every cell to the nearest blocked cell, between cell centres, in cells.
#[derive(Clone, Debug)]
pub struct DistanceField {
    width: usize,
    distances: Vec<f32>,
}

impl DistanceField {
    /// Computes the field of a grid of `width` columns, given row by row. The cells around the grid count as blocked.
    pub fn new(width: usize, blocked: impl IntoIterator<Item = bool>) -> Self {
        let mut squares: Vec<f32> = blocked.into_iter().map(|blocked| if blocked { 0.0 } else { f32::INFINITY }).collect();
        squared_distances_within_columns(width, &mut squares);
        let mut envelope = Envelope::default();
        for row in squares.chunks_exact_mut(width.max(1)) {
            envelope.replace_by_minima(row);
        }
        Self { width, distances: squares.into_iter().map(f32::sqrt).collect() }
    }

    /// The distance at a cell; 0 outside the grid.
    pub fn at(&self, column: i64, row: i64) -> f64 {
        match (usize::try_from(column), usize::try_from(row)) {
            (Ok(column), Ok(row)) if column < self.width => {
                self.distances.get(row * self.width + column).copied().map_or(0.0, f64::from)
            }
            _ => 0.0,
        }
    }
}

/// Computes the squared distance to the nearest blocked cell of the same column, with one sweep up and one down.
fn squared_distances_within_columns(width: usize, squares: &mut [f32]) {
    let height = squares.len().checked_div(width).unwrap_or(0);
    let mut steps = vec![0.0_f32; width];
    for row in 0..height {
        sweep(&mut steps, &mut squares[row * width..][..width]);
    }
    steps.fill(0.0);
    for row in (0..height).rev() {
        sweep(&mut steps, &mut squares[row * width..][..width]);
    }
}

/// Processes one row of a sweep; `steps` counts the rows since the last blocked cell of each column.
fn sweep(steps: &mut [f32], row: &mut [f32]) {
    for (steps, square) in steps.iter_mut().zip(row) {
        *steps = if *square == 0.0 { 0.0 } else { *steps + 1.0 };
        *square = square.min(*steps * *steps);
    }
}

/// The lower envelope of the parabolas `(x - vertex)^2 + height`, one for every cell of a row.
#[derive(Default)]
struct Envelope {
    /// Pieces of the envelope: vertex and height of the parabola, and the x at which the piece begins.
    pieces: Vec<(f64, f64, f64)>,
}

impl Envelope {
    /// Replaces each value of a row by the minimum of all parabolas at its cell.
    fn replace_by_minima(&mut self, row: &mut [f32]) {
        self.pieces.clear();
        self.pieces.push((-1.0, 0.0, f64::NEG_INFINITY)); // the blocked cell left of the row
        for (x, &height) in row.iter().enumerate() {
            self.add(x as f64, f64::from(height));
        }
        self.add(row.len() as f64, 0.0); // the blocked cell right of the row
        let mut piece = 0;
        for (x, value) in row.iter_mut().enumerate() {
            let x = x as f64;
            while self.pieces.get(piece + 1).is_some_and(|next| next.2 <= x) {
                piece += 1;
            }
            let (vertex, height, _) = self.pieces[piece];
            #[allow(clippy::cast_possible_truncation)] // whole numbers, exact up to 4096 cells and good to 1e-7 beyond
            let minimum = ((x - vertex).powi(2) + height) as f32;
            *value = minimum;
        }
    }

    /// Adds the parabola with the right-most vertex so far.
    fn add(&mut self, vertex: f64, height: f64) {
        while let Some(&(last, last_height, begins)) = self.pieces.last() {
            let meets = 0.5 * ((height - last_height) / (vertex - last) + vertex + last);
            if meets > begins {
                self.pieces.push((vertex, height, meets));
                return;
            }
            self.pieces.pop();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn distances_match_a_brute_force_search(width in 1_usize..12, bits in prop::collection::vec(prop::bool::weighted(0.1), 1..150)) {
            let height = bits.len().div_ceil(width);
            let mut blocked = bits;
            blocked.resize(width * height, false);
            let field = DistanceField::new(width, blocked.iter().copied());
            let (w, h) = (i64::try_from(width)?, i64::try_from(height)?);
            let around = (-1..=w).flat_map(|x| (-1..=h).map(move |y| (x, y)));
            let walls: Vec<_> = around
                .filter(|&(x, y)| x < 0 || y < 0 || x == w || y == h || blocked[usize::try_from(y * w + x).unwrap_or(0)])
                .collect();
            for y in 0..h {
                for x in 0..w {
                    let nearest = walls.iter().map(|(a, b)| ((a - x) as f64).hypot((b - y) as f64)).fold(f64::INFINITY, f64::min);
                    prop_assert!((field.at(x, y) - nearest).abs() < 1e-6, "({x}, {y}): {} is not {nearest}", field.at(x, y));
                }
            }
        }
    }
}
