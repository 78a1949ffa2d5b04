//! In which order the reduced columns are eliminated, and what that costs.
//!
//! Columns that always occur together are one node of a graph, in which two nodes are joined when a
//! term, or an eliminated block, sees both. The candidates are the order in which the columns come,
//! the reverse of Cuthill & McKee 1969, which suits chains and grids, and approximate minimum degree
//! of Amestoy, Davis & Duff 1996, which suits the rest. The one with the fewest operations is taken.

use std::collections::{BTreeSet, VecDeque};

use faer::dyn_stack::{MemBuffer, MemStack};
use faer::sparse::SymbolicSparseColMatRef;
use faer::sparse::linalg::amd;

/// Consecutive columns: the first and the one behind the last.
pub(crate) type Run = (u32, u32);

/// Sets of columns that become dense together, each as maximal runs in increasing order.
pub(crate) type Cliques = BTreeSet<Vec<Run>>;

/// Nodes joined to more than this many times the root of their number are put last: everything that
/// is eliminated after such a node would become dense.
const HUB_DEGREE: f64 = 10.0;

/// Nodes of columns, and which are joined.
#[derive(Debug)]
pub(crate) struct Graph {
    /// The first column of each node, and the number of columns at the end.
    pub first: Vec<u32>,
    /// For each node, those joined to it, in increasing order, without itself.
    pub neighbours: Vec<Vec<u32>>,
}

/// An order of the nodes, and the multiplications that a factorization takes in it.
#[derive(Debug)]
pub(crate) struct Ordering {
    pub nodes: Vec<u32>,
    pub operations: f64,
}

impl Graph {
    pub(crate) fn new(n_columns: usize, cliques: &Cliques) -> Self {
        let mut ends: Vec<u32> = cliques.iter().flatten().flat_map(|&(start, end)| [start, end]).collect();
        ends.extend([0, n_columns as u32]);
        ends.sort_unstable();
        ends.dedup();
        let n_nodes = ends.len() - 1;
        let mut node_of = vec![0; n_columns + 1];
        for (node, &end) in ends.iter().enumerate() {
            node_of[end as usize] = node as u32;
        }
        let members: Vec<Vec<u32>> = cliques
            .iter()
            .map(|runs| {
                runs.iter().flat_map(|&(start, end)| node_of[start as usize]..node_of[end as usize]).collect()
            })
            .collect();
        let mut cliques_of: Vec<Vec<u32>> = vec![Vec::new(); n_nodes];
        for (clique, nodes) in members.iter().enumerate() {
            nodes.iter().for_each(|&node| cliques_of[node as usize].push(clique as u32));
        }
        let mut seen_by = vec![u32::MAX; n_nodes];
        let neighbours = cliques_of.iter().enumerate().map(|(node, cliques)| {
            seen_by[node] = node as u32;
            let mut neighbours = Vec::new();
            for &other in cliques.iter().flat_map(|&clique| &members[clique as usize]) {
                if seen_by[other as usize] != node as u32 {
                    seen_by[other as usize] = node as u32;
                    neighbours.push(other);
                }
            }
            neighbours.sort_unstable();
            neighbours
        });
        Self { neighbours: neighbours.collect(), first: ends }
    }

    /// Returns a node's columns.
    pub(crate) fn columns(&self, node: u32) -> std::ops::Range<u32> {
        self.first[node as usize]..self.first[node as usize + 1]
    }

    fn n_nodes(&self) -> usize {
        self.neighbours.len()
    }

    /// Returns the number of a node's columns.
    fn width(&self, node: u32) -> f64 {
        self.columns(node).len() as f64
    }

    /// Returns the order that takes the fewest operations.
    pub(crate) fn best_order(&self) -> Ordering {
        let limit = HUB_DEGREE * (self.n_nodes() as f64).sqrt();
        let is_hub = |node: u32| self.neighbours[node as usize].len() as f64 > limit;
        let (hubs, others): (Vec<u32>, Vec<u32>) = (0..self.n_nodes() as u32).partition(|&node| is_hub(node));
        let natural = others.iter().chain(&hubs).copied().collect();
        let breadth_first = self.reverse_cuthill_mckee(&others).into_iter().chain(hubs).collect();
        // The first of equals wins, so that the order is the same everywhere.
        let mut best = self.with_operations(natural);
        for nodes in [Some(breadth_first), self.minimum_degree()].into_iter().flatten() {
            let other = self.with_operations(nodes);
            if other.operations < best.operations {
                best = other;
            }
        }
        best
    }

    /// Orders some nodes by their distance from one at the rim, of each component; others do not count.
    fn reverse_cuthill_mckee(&self, nodes: &[u32]) -> Vec<u32> {
        const FAR: u32 = u32::MAX;
        const ABSENT: u32 = u32::MAX - 1;
        let mut distance = vec![ABSENT; self.n_nodes()];
        nodes.iter().for_each(|&node| distance[node as usize] = FAR);
        let degree = |node: u32| self.neighbours[node as usize].len();
        // Visits a component and returns it in order of distance, neighbours of small degree first.
        let visit = |from: u32, distance: &mut [u32]| -> Vec<u32> {
            let mut order = Vec::new();
            let mut queue = VecDeque::from([from]);
            distance[from as usize] = 0;
            while let Some(node) = queue.pop_front() {
                order.push(node);
                let mut next: Vec<u32> = self.neighbours[node as usize]
                    .iter()
                    .copied()
                    .filter(|&other| distance[other as usize] == FAR)
                    .collect();
                next.sort_by_key(|&other| (degree(other), other));
                for other in next {
                    distance[other as usize] = distance[node as usize] + 1;
                    queue.push_back(other);
                }
            }
            order
        };
        let mut result = Vec::with_capacity(nodes.len());
        for &node in nodes {
            if distance[node as usize] != FAR {
                continue;
            }
            // The node found last is far from the first, and a better place to start from.
            let mut from = node;
            for _ in 0..2 {
                let order = visit(from, &mut distance);
                from = *order.last().expect("it has the node that it started from");
                order.iter().for_each(|&node| distance[node as usize] = FAR);
            }
            result.extend(visit(from, &mut distance));
        }
        result.reverse();
        result
    }

    /// Returns the order of approximate minimum degree, or `None` if there is no room to find it.
    fn minimum_degree(&self) -> Option<Vec<u32>> {
        let n = self.n_nodes();
        let mut starts = vec![0_u32];
        let mut rows = Vec::new();
        for (node, neighbours) in self.neighbours.iter().enumerate() {
            rows.extend(neighbours.iter().take_while(|&&other| other < node as u32));
            rows.push(node as u32);
            starts.push(u32::try_from(rows.len()).ok()?);
        }
        let upper = SymbolicSparseColMatRef::new_checked(n, n, &starts, None, &rows);
        let (mut order, mut inverse) = (vec![0_u32; n], vec![0_u32; n]);
        let mut room = MemBuffer::try_new(amd::order_scratch::<u32>(n, rows.len())).ok()?;
        amd::order(&mut order, &mut inverse, upper, amd::Control::default(), MemStack::new(&mut room))
            .ok()?;
        Some(order)
    }

    /// Counts the operations of a factorization in this order, from the fill that it makes.
    fn with_operations(&self, nodes: Vec<u32>) -> Ordering {
        const NONE: u32 = u32::MAX;
        let n = self.n_nodes();
        let mut place = vec![0; n];
        nodes.iter().enumerate().for_each(|(at, &node)| place[node as usize] = at as u32);
        // A row of the factor reaches from its entries up the elimination tree (Liu 1986).
        let mut parent = vec![NONE; n];
        let mut seen_by = vec![NONE; n];
        let mut rows_below = vec![0.0; n];
        for (row, &node) in nodes.iter().enumerate() {
            seen_by[row] = row as u32;
            for &other in &self.neighbours[node as usize] {
                let mut column = place[other as usize] as usize;
                while column < row && seen_by[column] != row as u32 {
                    seen_by[column] = row as u32;
                    rows_below[column] += self.width(node);
                    if parent[column] == NONE {
                        parent[column] = row as u32;
                    }
                    column = parent[column] as usize;
                }
            }
        }
        let operations = |(&node, below): (&u32, f64)| {
            let width = self.width(node);
            width * (width * width / 6.0 + below * width / 2.0 + below * below / 2.0)
        };
        let operations = nodes.iter().zip(rows_below).map(operations).sum();
        Ordering { nodes, operations }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn graph(n_columns: usize, cliques: &[&[Run]]) -> Graph {
        Graph::new(n_columns, &cliques.iter().map(|runs| runs.to_vec()).collect())
    }

    fn check_permutation(ordering: &Ordering, n: usize) {
        let mut sorted = ordering.nodes.clone();
        sorted.sort_unstable();
        assert_eq!(sorted, (0..n as u32).collect::<Vec<_>>());
    }

    #[test]
    fn columns_that_occur_together_are_a_node() {
        let graph = graph(10, &[&[(0, 6)], &[(2, 4), (8, 10)]]);
        assert_eq!(graph.first, [0, 2, 4, 6, 8, 10]);
        assert_eq!(graph.neighbours, [vec![1, 2], vec![0, 2, 4], vec![0, 1], vec![], vec![1]]);
    }

    #[test]
    fn a_shuffled_chain_is_unravelled() {
        // Links (k, k+1) of a chain whose nodes are numbered in steps of 37 modulo 101.
        let n = 101;
        let name = |k: usize| (k * 37 % n) as u32;
        let links: Vec<Vec<Run>> = (1..n)
            .map(|k| {
                let (a, b) = (name(k - 1).min(name(k)), name(k - 1).max(name(k)));
                vec![(a, a + 1), (b, b + 1)]
            })
            .collect();
        let graph = Graph::new(n, &links.into_iter().collect());
        let ordering = graph.best_order();
        check_permutation(&ordering, n);
        // Nothing fills in: each column has one entry below its diagonal.
        assert!((ordering.operations - (n as f64 / 6.0 + (n as f64 - 1.0))).abs() < 1e-9, "{ordering:?}");
    }

    #[test]
    fn hubs_come_last() {
        // A star of 500 leaves around the first node.
        let leaves: Vec<Vec<Run>> = (1..=500).map(|k| vec![(0, 1), (k, k + 1)]).collect();
        let graph = Graph::new(501, &leaves.into_iter().collect());
        let ordering = graph.best_order();
        check_permutation(&ordering, 501);
        assert!(ordering.operations < 1000.0, "{}", ordering.operations);
    }

    #[test]
    fn operations_of_a_clique_are_those_of_a_dense_factorization() {
        let ordering = graph(30, &[&[(0, 30)]]).best_order();
        assert!((ordering.operations - 30.0_f64.powi(3) / 6.0).abs() < 1e-9);
        // In pieces: the same up to lower orders.
        let singles: Vec<Vec<Run>> =
            (0..30).flat_map(|a| (0..a).map(move |b| vec![(b, b + 1), (a, a + 1)])).collect();
        let pieces = Graph::new(30, &singles.into_iter().collect()).best_order();
        assert!((pieces.operations / ordering.operations - 1.0).abs() < 0.01, "{}", pieces.operations);
    }
}
