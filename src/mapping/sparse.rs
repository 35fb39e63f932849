//! Sparse symmetric positive definite systems of 3 x 3 blocks: fill-reducing ordering, decomposition `L D L'`, and solution.
//!
//! The elimination order is that of minimum degree (Tinney and Walker 1967; George and Liu 1989, "The evolution of the minimum degree
//! ordering algorithm"). The elimination graph also yields the sparsity pattern of `L`, so both are computed together.

use std::collections::BTreeSet;

use nalgebra::{Matrix3, Vector3};

/// Sparsity pattern of a matrix and of its factor.
#[derive(Clone, Debug, Default)]
pub(super) struct Pattern {
    /// Position of each variable in the elimination order.
    positions: Vec<usize>,
    /// By position in the elimination order: rows of the nonzero blocks of `L` below the diagonal, ascending.
    columns: Vec<Vec<usize>>,
}

impl Pattern {
    /// The pattern for `count` variables; `pairs` lists the nonzero blocks off the diagonal.
    pub(super) fn new(count: usize, pairs: impl IntoIterator<Item = (usize, usize)>) -> Self {
        let mut neighbours = vec![BTreeSet::new(); count];
        for (a, b) in pairs.into_iter().filter(|(a, b)| a != b) {
            neighbours[a].insert(b);
            neighbours[b].insert(a);
        }
        let mut neighbours: Vec<Vec<usize>> = neighbours.into_iter().map(|set| set.into_iter().collect()).collect();
        let mut by_degree: BTreeSet<(usize, usize)> = neighbours.iter().enumerate().map(|(v, n)| (n.len(), v)).collect();
        let mut positions = vec![0; count];
        let mut columns = Vec::with_capacity(count);
        while let Some((_, eliminated)) = by_degree.pop_first() {
            positions[eliminated] = columns.len();
            let clique = std::mem::take(&mut neighbours[eliminated]);
            for &v in &clique {
                by_degree.remove(&(neighbours[v].len(), v));
                neighbours[v] = union_without(&neighbours[v], &clique, v, eliminated);
                by_degree.insert((neighbours[v].len(), v));
            }
            columns.push(clique);
        }
        for column in &mut columns {
            for v in column.iter_mut() {
                *v = positions[*v];
            }
            column.sort_unstable();
        }
        Self { positions, columns }
    }

    /// Number of variables.
    fn len(&self) -> usize {
        self.positions.len()
    }

    /// A matrix of zeros.
    pub(super) fn zeros(&self) -> BlockMatrix<'_> {
        let below = self.columns.iter().map(|column| vec![Matrix3::zeros(); column.len()]).collect();
        BlockMatrix { pattern: self, diagonal: vec![Matrix3::zeros(); self.len()], below }
    }
}

/// The union of two ascending lists, without `a` and `b`.
fn union_without(one: &[usize], other: &[usize], a: usize, b: usize) -> Vec<usize> {
    let mut union = Vec::with_capacity(one.len() + other.len());
    let (mut i, mut j) = (0, 0);
    while i < one.len() || j < other.len() {
        let next = match (one.get(i), other.get(j)) {
            (Some(&x), Some(&y)) => x.min(y),
            (Some(&x), None) | (None, Some(&x)) => x,
            (None, None) => break,
        };
        i += usize::from(one.get(i) == Some(&next));
        j += usize::from(other.get(j) == Some(&next));
        if next != a && next != b {
            union.push(next);
        }
    }
    union
}

/// A symmetric matrix; only the blocks on and below the diagonal are stored.
#[derive(Clone, Debug)]
pub(super) struct BlockMatrix<'a> {
    pattern: &'a Pattern,
    diagonal: Vec<Matrix3<f64>>,
    below: Vec<Vec<Matrix3<f64>>>,
}

impl<'a> BlockMatrix<'a> {
    /// Adds to the block of row `a` and column `b`, and the transpose to the opposite block. Blocks outside the pattern are ignored.
    pub(super) fn add(&mut self, a: usize, b: usize, block: &Matrix3<f64>) {
        let (row, column) = (self.pattern.positions[a], self.pattern.positions[b]);
        match row.cmp(&column) {
            std::cmp::Ordering::Equal => self.diagonal[row] += block,
            std::cmp::Ordering::Greater => self.add_below(row, column, block),
            std::cmp::Ordering::Less => self.add_below(column, row, &block.transpose()),
        }
    }

    fn add_below(&mut self, row: usize, column: usize, block: &Matrix3<f64>) {
        if let Ok(i) = self.pattern.columns[column].binary_search(&row) {
            self.below[column][i] += block;
        }
    }

    /// Decomposes the matrix; `None` if it is not positive definite.
    pub(super) fn factorize(mut self) -> Option<Factor<'a>> {
        for j in 0..self.pattern.len() {
            let inverse = self.diagonal[j].cholesky()?.inverse();
            let column = std::mem::take(&mut self.below[j]);
            let scaled: Vec<Matrix3<f64>> = column.iter().map(|block| block * inverse).collect();
            self.subtract_products(j, &column, &scaled);
            self.diagonal[j] = inverse;
            self.below[j] = scaled;
        }
        Some(Factor { pattern: self.pattern, inverses: self.diagonal, below: self.below })
    }

    /// Right-looking update: subtracts the products of column `j` from the columns of its rows, whose patterns contain all later rows
    /// of column `j`.
    fn subtract_products(&mut self, j: usize, column: &[Matrix3<f64>], scaled: &[Matrix3<f64>]) {
        let rows = &self.pattern.columns[j];
        for (k, &target) in rows.iter().enumerate() {
            subtract_product(&mut self.diagonal[target], &scaled[k], &column[k]);
            let target_rows = &self.pattern.columns[target];
            let mut position = 0;
            for i in k + 1..rows.len() {
                while target_rows[position] != rows[i] {
                    position += 1;
                }
                subtract_product(&mut self.below[target][position], &scaled[i], &column[k]);
            }
        }
    }
}

/// Subtracts `a b'` from `target`. Unrolled by hand, because most of the time is spent here.
#[inline(always)]
fn subtract_product(target: &mut Matrix3<f64>, a: &Matrix3<f64>, b: &Matrix3<f64>) {
    let (a, b) = (&a.data.0, &b.data.0);
    for (j, column) in target.data.0.iter_mut().enumerate() {
        for (i, value) in column.iter_mut().enumerate() {
            *value -= a[0][i] * b[0][j] + a[1][i] * b[1][j] + a[2][i] * b[2][j];
        }
    }
}

/// The decomposition `L D L'`, with the inverses of the blocks of `D`.
#[derive(Clone, Debug)]
pub(super) struct Factor<'a> {
    pattern: &'a Pattern,
    inverses: Vec<Matrix3<f64>>,
    below: Vec<Vec<Matrix3<f64>>>,
}

impl Factor<'_> {
    /// Solves for a right-hand side; it and the solution are in the order of the variables.
    pub(super) fn solve(&self, rhs: &[Vector3<f64>]) -> Vec<Vector3<f64>> {
        let mut x = vec![Vector3::zeros(); self.pattern.len()];
        for (&position, value) in self.pattern.positions.iter().zip(rhs) {
            x[position] = *value;
        }
        for j in 0..x.len() {
            let value = x[j];
            for (&i, block) in self.pattern.columns[j].iter().zip(&self.below[j]) {
                x[i] -= block * value;
            }
        }
        for j in (0..x.len()).rev() {
            let mut value = self.inverses[j] * x[j];
            for (&i, block) in self.pattern.columns[j].iter().zip(&self.below[j]) {
                value -= block.tr_mul(&x[i]);
            }
            x[j] = value;
        }
        self.pattern.positions.iter().map(|&position| x[position]).collect()
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::{DMatrix, DVector};
    use proptest::prelude::*;

    use super::*;

    /// Number of nonzero blocks of the factor below its diagonal.
    fn fill(pattern: &Pattern) -> usize {
        pattern.columns.iter().map(Vec::len).sum()
    }

    #[test]
    fn minimum_degree_avoids_fill_in_on_chains_and_limits_it_on_grids() {
        let chain = Pattern::new(100, (1..100).map(|i| (i - 1, i)));
        assert_eq!(fill(&chain), 99);
        let at = |x: usize, y: usize| 20 * y + x;
        let sideways = (0..20).flat_map(|y| (1..20).map(move |x| (at(x - 1, y), at(x, y))));
        let upwards = (1..20).flat_map(|y| (0..20).map(move |x| (at(x, y - 1), at(x, y))));
        let grid = Pattern::new(400, sideways.chain(upwards));
        assert!(fill(&grid) < 400 * 20 / 2, "{}", fill(&grid));
    }

    proptest! {
        #[test]
        fn solutions_match_the_dense_matrix(
            pairs in prop::collection::vec((0_usize..12, 0_usize..12), 0..40),
            numbers in prop::collection::vec(-1.0..1.0_f64, 40 * 9 + 36),
        ) {
            let pattern = Pattern::new(12, pairs.iter().copied());
            let mut matrix = pattern.zeros();
            let mut dense = DMatrix::<f64>::zeros(36, 36);
            let mut add = |a: usize, b: usize, block: &Matrix3<f64>| {
                matrix.add(a, b, block);
                for (row, column) in (0..3).flat_map(|row| (0..3).map(move |column| (row, column))) {
                    dense[(3 * a + row, 3 * b + column)] += block[(row, column)];
                    if a != b {
                        dense[(3 * b + column, 3 * a + row)] += block[(row, column)];
                    }
                }
            };
            for (i, &(a, b)) in pairs.iter().enumerate() {
                let block = Matrix3::from_column_slice(&numbers[9 * i..9 * i + 9]);
                add(a, b, &if a == b { block + block.transpose() } else { block });
            }
            (0..12).for_each(|a| add(a, a, &(Matrix3::identity() * 200.0)));
            let rhs = &numbers[360..];
            let blocks: Vec<_> = rhs.chunks_exact(3).map(Vector3::from_column_slice).collect();
            let solution = matrix.factorize().unwrap().solve(&blocks);
            let expected = dense.cholesky().unwrap().solve(&DVector::from_column_slice(rhs));
            for (i, value) in solution.iter().flat_map(|block| block.iter().copied().collect::<Vec<_>>()).enumerate() {
                prop_assert!((value - expected[i]).abs() < 1e-12, "{i}: {value} is not {}", expected[i]);
            }
        }
    }

    #[test]
    fn matrices_that_are_not_positive_definite_have_no_factor() {
        let pattern = Pattern::new(2, [(0, 1)]);
        let mut matrix = pattern.zeros();
        matrix.add(0, 0, &Matrix3::identity());
        assert!(matrix.factorize().is_none());
    }
}
