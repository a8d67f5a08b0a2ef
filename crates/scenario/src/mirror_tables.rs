//! The mirror arrays of a scenario: one table `[mirrors]`, or several tables `[[mirrors]]`.

use std::fmt;

use serde::de::value::MapAccessDeserializer;
use serde::de::{Error, MapAccess, SeqAccess, Visitor};
use serde::{Deserialize, Deserializer, Serialize, Serializer};

use crate::tables::Mirrors;

/// The tables of the mirror arrays, at least one. Mirrors have one index, array after array.
#[derive(Clone, Debug, PartialEq)]
pub struct MirrorTables(Vec<Mirrors>);

impl MirrorTables {
    /// The arrays in the order of their mirrors.
    pub fn arrays(&self) -> &[Mirrors] {
        &self.0
    }

    /// The arrays, to change them.
    pub fn arrays_mut(&mut self) -> &mut [Mirrors] {
        &mut self.0
    }

    /// The first array: the only one, unless the scenario has several.
    pub fn first(&self) -> &Mirrors {
        &self.0[0]
    }

    /// The first array, to change it.
    pub fn first_mut(&mut self) -> &mut Mirrors {
        &mut self.0[0]
    }

    /// The array with this index alone.
    pub fn alone(&self, index: usize) -> Option<Self> {
        self.0.get(index).map(|array| Self(vec![array.clone()]))
    }

    /// Number of mirrors of all arrays.
    pub fn count(&self) -> usize {
        self.0.iter().map(|array| array.rows * array.columns).sum()
    }

    /// Number of columns of all arrays.
    pub fn columns(&self) -> usize {
        self.0.iter().map(|array| array.columns).sum()
    }

    /// The key of an array in messages: `mirrors`, or with its index from 0 where there are several.
    pub(crate) fn key(&self, index: usize) -> String {
        if self.0.len() == 1 { "mirrors".into() } else { format!("mirrors.{index}") }
    }
}

impl Default for MirrorTables {
    fn default() -> Self {
        Self(vec![Mirrors::default()])
    }
}

/// Rows and columns, as `10 x 10`; those of several arrays with `and` between them.
impl fmt::Display for MirrorTables {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        for (index, Mirrors { rows, columns, .. }) in self.0.iter().enumerate() {
            let before = if index == 0 { "" } else { " and " };
            write!(formatter, "{before}{rows} x {columns}")?;
        }
        Ok(())
    }
}

impl Serialize for MirrorTables {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        match self.0.as_slice() {
            [array] => array.serialize(serializer),
            arrays => arrays.serialize(serializer),
        }
    }
}

impl<'de> Deserialize<'de> for MirrorTables {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        deserializer.deserialize_any(OneOrSeveral)
    }
}

struct OneOrSeveral;

impl<'de> Visitor<'de> for OneOrSeveral {
    type Value = MirrorTables;

    fn expecting(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str("a table [mirrors], or several tables [[mirrors]]")
    }

    fn visit_map<A: MapAccess<'de>>(self, map: A) -> Result<MirrorTables, A::Error> {
        Mirrors::deserialize(MapAccessDeserializer::new(map)).map(|array| MirrorTables(vec![array]))
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut tables: A) -> Result<MirrorTables, A::Error> {
        let mut arrays = Vec::new();
        while let Some(array) = tables.next_element()? {
            arrays.push(array);
        }
        if arrays.is_empty() { Err(A::Error::invalid_length(0, &self)) } else { Ok(MirrorTables(arrays)) }
    }
}
