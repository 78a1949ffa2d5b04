//! A view through a lens with local support as a matrix over all its columns.

use boresight_solver::{Accumulated, EliminatedSums, GramMut, LocalTerm, Scratch, Values};

use crate::reprojection::Reprojection;

impl Reprojection {
    /// Does what [`Term::linearize`](boresight_solver::Term::linearize) asks for, from what the term
    /// says of its parts.
    pub(in crate::reprojection) fn linearize_whole(
        &self,
        term: &dyn LocalTerm,
        values: Values<'_>,
        gram: &mut GramMut<'_>,
        scratch: &mut Scratch,
    ) -> Option<f64> {
        gram.clear();
        // Any link will do as the one that is told apart; behind the last is only the residual.
        let n = gram.size() - 7;
        let support: Vec<u32> = (0..n as u32).collect();
        let mut sums = vec![0.0; term.sum_count()];
        let (mut own, mut gradient, mut coupling) = ([[0.0; 6]; 6], [0.0; 6], vec![0.0; 6 * n]);
        let mut eliminated = EliminatedSums {
            block: self.chain.blocks().last(),
            own: &mut own,
            gradient: &mut gradient,
            coupling: &mut coupling,
        };
        let accumulated = term.accumulate(values, &support, &mut sums, &mut eliminated, scratch);
        let Accumulated::Cost(cost) = accumulated else { return None };
        let pairs = term.entries();
        let mut entries = vec![0.0; pairs.len()];
        term.expand(values, &sums, &mut entries);
        let column = |column: u32| if column as usize == n { n + 6 } else { column as usize };
        for ([a, b], entry) in pairs.into_iter().zip(entries) {
            gram.add(column(a), column(b), entry);
        }
        for (k, own) in own.iter().enumerate() {
            own.iter().enumerate().skip(k).for_each(|(l, entry)| gram.add(n + k, n + l, *entry));
            gram.add(n + k, n + 6, gradient[k]);
            for (a, entry) in coupling[k * n..(k + 1) * n].iter().enumerate() {
                gram.add(a, n + k, *entry);
            }
        }
        gram.add(n + 6, n + 6, self.layout.squares(scratch.gram.sums()));
        Some(cost)
    }
}
