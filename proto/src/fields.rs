//! How the fields of messages are read, written and checked, and the macro that does so for a
//! structure.

use crate::codec::{BufferFull, Reader, Unreadable, Writer};
use crate::error::CodecError;
use crate::kind::Kind;
use crate::limits::{LENGTH_TOLERANCE, MAX_MIRRORS, MAX_TEXT};

/// A type that a field can have.
pub(crate) trait Value {
    /// Reads the next value; lists and texts keep their memory.
    fn read(&mut self, reader: &mut Reader<'_>, place: Place, bounds: Bounds) -> Result<(), CodecError>;

    /// Writes the value.
    fn write(&self, writer: &mut Writer<'_>) -> Result<(), BufferFull>;

    /// Checks what the type and the bounds allow.
    fn check(&self, place: Place, bounds: Bounds) -> Result<(), CodecError>;
}

/// A field of a message, for refusals.
#[derive(Clone, Copy)]
pub(crate) struct Place {
    kind: Kind,
    field: &'static str,
    index: Option<usize>,
}

impl Place {
    /// The message as a whole.
    pub(crate) const fn message(kind: Kind) -> Self {
        Self { kind, field: "", index: None }
    }

    /// A field of the structure at this place. A field without a name of its own keeps the name of
    /// the structure and is told apart by its position.
    pub(crate) fn inside(self, name: Option<&'static str>, position: Option<usize>) -> Self {
        match name {
            Some(field) => Self { field, ..self },
            None => Self { index: self.index.or(position), ..self },
        }
    }

    /// An entry of the list at this place; of nested lists the outer index stays.
    fn entry(self, index: usize) -> Self {
        Self { index: self.index.or(Some(index)), ..self }
    }

    /// The refusal of bytes that are not a value.
    pub(crate) fn unreadable(self, reason: Unreadable) -> CodecError {
        let Self { kind, field, .. } = self;
        match reason {
            Unreadable::Truncated => CodecError::Truncated { kind, field },
            Unreadable::Invalid(problem) => CodecError::Malformed { kind, field, problem },
        }
    }

    fn too_many(self, found: u64, limit: usize) -> CodecError {
        CodecError::TooMany { kind: self.kind, field: self.field, found, limit }
    }

    fn out_of_domain(self, value: f64, expected: &'static str) -> CodecError {
        let index = self.index.unwrap_or(0);
        CodecError::OutOfDomain { kind: self.kind, field: self.field, index, value, expected }
    }

    /// The one check that a number is finite, and within its bounds.
    #[inline]
    fn check_number(self, value: f64, bounds: Bounds) -> Result<(), CodecError> {
        // Comparisons with NaN are false, and all bounds are finite.
        if value >= bounds.least && value <= bounds.most { Ok(()) } else { Err(self.bad_number(value, bounds)) }
    }

    #[cold]
    fn bad_number(self, value: f64, bounds: Bounds) -> CodecError {
        if value.is_finite() {
            return self.out_of_domain(value, bounds.expected);
        }
        CodecError::NotFinite { kind: self.kind, field: self.field, index: self.index.unwrap_or(0), value }
    }
}

/// Rules for one field that do not follow from its type.
#[derive(Clone, Copy)]
pub(crate) struct Bounds {
    entries: usize,
    text: usize,
    least: f64,
    most: f64,
    expected: &'static str,
}

impl Bounds {
    /// No rule; a list has no entries until [`at_most`](Self::at_most) allows some.
    pub(crate) const NONE: Self =
        Self { entries: 0, text: MAX_TEXT, least: f64::MIN, most: f64::MAX, expected: "a finite number" };

    /// A list has at most this many entries.
    pub(crate) const fn at_most(self, entries: usize) -> Self {
        Self { entries, ..self }
    }

    /// A text has at most this many bytes.
    pub(crate) const fn text_at_most(self, text: usize) -> Self {
        Self { text, ..self }
    }

    /// Each number is 0 or above.
    pub(crate) const fn not_negative(self) -> Self {
        Self { least: 0.0, expected: "a number that is not negative", ..self }
    }

    /// Each number is a share, from 0 to 1.
    pub(crate) const fn share(self) -> Self {
        Self { least: 0.0, most: 1.0, expected: "a share from 0 to 1", ..self }
    }
}

/// Implements [`Value`] for types that postcard reads and writes as a whole.
macro_rules! plain_values {
    ($($plain:ty, $check:expr;)*) => { $(
        impl Value for $plain {
            #[inline]
            fn read(&mut self, reader: &mut Reader<'_>, place: Place, _: Bounds) -> Result<(), CodecError> {
                reader.take(self).map_err(|reason| place.unreadable(reason))
            }

            #[inline]
            fn write(&self, writer: &mut Writer<'_>) -> Result<(), BufferFull> {
                writer.put(self)
            }

            #[inline]
            fn check(&self, place: Place, bounds: Bounds) -> Result<(), CodecError> {
                let check: fn(&Self, Place, Bounds) -> Result<(), CodecError> = $check;
                check(self, place, bounds)
            }
        }
    )* };
}

plain_values! {
    bool, |_, _, _| Ok(());
    u32, |_, _, _| Ok(());
    u64, |_, _, _| Ok(());
    f32, |number, place, bounds| place.check_number(f64::from(*number), bounds);
    f64, |number, place, bounds| place.check_number(*number, bounds);
    String, |text, place, bounds| match text.len() {
        found if found <= bounds.text => Ok(()),
        found => Err(place.too_many(found as u64, bounds.text)),
    };
}

impl<T: Value, const N: usize> Value for [T; N] {
    #[inline]
    fn read(&mut self, reader: &mut Reader<'_>, place: Place, bounds: Bounds) -> Result<(), CodecError> {
        let mut entries = self.iter_mut().enumerate();
        entries.try_for_each(|(index, entry)| entry.read(reader, place.entry(index), bounds))
    }

    #[inline]
    fn write(&self, writer: &mut Writer<'_>) -> Result<(), BufferFull> {
        self.iter().try_for_each(|entry| entry.write(writer))
    }

    #[inline]
    fn check(&self, place: Place, bounds: Bounds) -> Result<(), CodecError> {
        let mut entries = self.iter().enumerate();
        entries.try_for_each(|(index, entry)| entry.check(place.entry(index), bounds))
    }
}

impl<T: Value + Default> Value for Option<T> {
    #[inline]
    fn read(&mut self, reader: &mut Reader<'_>, place: Place, bounds: Bounds) -> Result<(), CodecError> {
        let mut is_present = false;
        is_present.read(reader, place, Bounds::NONE)?;
        if is_present {
            return self.get_or_insert_default().read(reader, place, bounds);
        }
        *self = None;
        Ok(())
    }

    #[inline]
    fn write(&self, writer: &mut Writer<'_>) -> Result<(), BufferFull> {
        self.is_some().write(writer)?;
        self.iter().try_for_each(|value| value.write(writer))
    }

    #[inline]
    fn check(&self, place: Place, bounds: Bounds) -> Result<(), CodecError> {
        self.iter().try_for_each(|value| value.check(place, bounds))
    }
}

impl<T: Value + Default> Value for Vec<T> {
    /// Refuses a length above the limit before it allocates anything for the entries.
    fn read(&mut self, reader: &mut Reader<'_>, place: Place, bounds: Bounds) -> Result<(), CodecError> {
        let mut found = 0u64;
        found.read(reader, place, Bounds::NONE)?;
        if found > bounds.entries as u64 {
            return Err(place.too_many(found, bounds.entries));
        }
        let count = found as usize;
        self.truncate(count);
        for (index, entry) in self.iter_mut().enumerate() {
            entry.read(reader, place.entry(index), bounds)?;
        }
        self.reserve(count - self.len());
        while self.len() < count {
            let mut entry = T::default();
            entry.read(reader, place.entry(self.len()), bounds)?;
            self.push(entry);
        }
        Ok(())
    }

    fn write(&self, writer: &mut Writer<'_>) -> Result<(), BufferFull> {
        (self.len() as u64).write(writer)?;
        self.iter().try_for_each(|entry| entry.write(writer))
    }

    fn check(&self, place: Place, bounds: Bounds) -> Result<(), CodecError> {
        if self.len() > bounds.entries {
            return Err(place.too_many(self.len() as u64, bounds.entries));
        }
        let mut entries = self.iter().enumerate();
        entries.try_for_each(|(index, entry)| entry.check(place.entry(index), bounds))
    }
}

/// Bytes whose meaning the contract does not define.
impl Value for Vec<u8> {
    fn read(&mut self, reader: &mut Reader<'_>, place: Place, bounds: Bounds) -> Result<(), CodecError> {
        let mut bytes: &[u8] = &[];
        reader.take(&mut bytes).map_err(|reason| place.unreadable(reason))?;
        if bytes.len() > bounds.entries {
            return Err(place.too_many(bytes.len() as u64, bounds.entries));
        }
        self.clear();
        self.extend_from_slice(bytes);
        Ok(())
    }

    fn write(&self, writer: &mut Writer<'_>) -> Result<(), BufferFull> {
        writer.put_bytes(self)
    }

    fn check(&self, place: Place, bounds: Bounds) -> Result<(), CodecError> {
        if self.len() > bounds.entries { Err(place.too_many(self.len() as u64, bounds.entries)) } else { Ok(()) }
    }
}

impl<A: Value, B: Value> Value for (A, B) {
    fn read(&mut self, reader: &mut Reader<'_>, place: Place, bounds: Bounds) -> Result<(), CodecError> {
        self.0.read(reader, place, bounds)?;
        self.1.read(reader, place, bounds)
    }

    fn write(&self, writer: &mut Writer<'_>) -> Result<(), BufferFull> {
        self.0.write(writer)?;
        self.1.write(writer)
    }

    fn check(&self, place: Place, bounds: Bounds) -> Result<(), CodecError> {
        self.0.check(place, bounds)?;
        self.1.check(place, bounds)
    }
}

/// Implements [`Value`] for a structure: reader, writer and checks take the fields in the given
/// order.
///
/// Each of the three destructures the structure, so that a field missing from the list does not
/// compile. `$naming` gives the names of the fields in refusals: `[message]` for their own, `[in
/// users]` for `users.FIELD`, and `[]` for the name of the field that holds the structure.
macro_rules! implement_value {
    (
        $structure:ident, $naming:tt,
        { $( $field:ident [$($rule:ident $(($limit:expr))?)*] )* },
        [$( $relation:ident($($of:ident),+) )*]
    ) => {
        impl Value for $structure {
            fn read(&mut self, reader: &mut Reader<'_>, place: Place, _: Bounds) -> Result<(), CodecError> {
                let Self { $($field),* } = self;
                let mut positions = 0..;
                $(
                    let inner = place.inside(field_name!($naming, $field), positions.next());
                    $field.read(reader, inner, Bounds::NONE$(.$rule($($limit)?))*)?;
                )*
                Ok(())
            }

            fn write(&self, writer: &mut Writer<'_>) -> Result<(), BufferFull> {
                let Self { $($field),* } = self;
                $( $field.write(writer)?; )*
                Ok(())
            }

            fn check(&self, place: Place, _: Bounds) -> Result<(), CodecError> {
                let Self { $($field),* } = self;
                let mut positions = 0..;
                $(
                    let inner = place.inside(field_name!($naming, $field), positions.next());
                    $field.check(inner, Bounds::NONE$(.$rule($($limit)?))*)?;
                )*
                $( $relation(place, $((stringify!($of), $of)),+)?; )*
                Ok(())
            }
        }
    };
}

/// Name of a field in refusals, see [`implement_value`].
macro_rules! field_name {
    ([message], $field:ident) => {
        Some(stringify!($field))
    };
    ([in $list:ident], $field:ident) => {
        Some(concat!(stringify!($list), ".", stringify!($field)))
    };
    ([], $field:ident) => {
        None
    };
}

pub(crate) use {field_name, implement_value};

/// Rule for two fields: the first list is as long as the second.
pub(crate) fn same_length<T, U>(
    place: Place,
    (field, list): (&'static str, &Vec<T>),
    (like, other): (&'static str, &Vec<U>),
) -> Result<(), CodecError> {
    let (found, expected) = (list.len(), other.len());
    if found == expected {
        return Ok(());
    }
    Err(CodecError::LengthMismatch { kind: place.kind, field, found, like, expected })
}

/// Rule for two fields: the first list is empty or as long as the second.
pub(crate) fn same_length_or_empty<T, U>(
    place: Place,
    list: (&'static str, &Vec<T>),
    other: (&'static str, &Vec<U>),
) -> Result<(), CodecError> {
    if list.1.is_empty() { Ok(()) } else { same_length(place, list, other) }
}

/// Rule for two fields: rows times columns is the number of mirrors of an array.
pub(crate) fn mirrors_within_limit(
    place: Place,
    (_, rows): (&'static str, &u32),
    (_, columns): (&'static str, &u32),
) -> Result<(), CodecError> {
    let found = u64::from(*rows) * u64::from(*columns);
    if found <= MAX_MIRRORS as u64 {
        return Ok(());
    }
    Err(Place { field: "rows * columns", ..place }.too_many(found, MAX_MIRRORS))
}

/// Rule for two fields: the smallest angle is not above the largest.
pub(crate) fn ordered(
    place: Place,
    (_, smallest): (&'static str, &f32),
    (_, largest): (&'static str, &f32),
) -> Result<(), CodecError> {
    if smallest <= largest {
        return Ok(());
    }
    Err(place.out_of_domain(f64::from(*smallest), "a smallest angle that is not above the largest"))
}

/// Rule for one field: a quaternion has length 1.
pub(crate) fn is_rotation(place: Place, (field, quaternion): (&'static str, &[f32; 4])) -> Result<(), CodecError> {
    let length = quaternion.iter().map(|part| f64::from(*part).powi(2)).sum::<f64>().sqrt();
    if (length - 1.0).abs() <= LENGTH_TOLERANCE {
        return Ok(());
    }
    Err(Place { field, ..place }.out_of_domain(length, "a quaternion of length 1"))
}

/// Share by which a covariance may exceed its bound, because variances are rounded to f32.
const COVARIANCE_ROUNDING: f64 = 1e-5;

/// Rule for three fields: the covariance is within the bound that both variances set, xy^2 <= xx yy.
pub(crate) fn is_covariance(
    place: Place,
    (field, xy): (&'static str, &f32),
    (_, xx): (&'static str, &f32),
    (_, yy): (&'static str, &f32),
) -> Result<(), CodecError> {
    let [xx, xy, yy] = [*xx, *xy, *yy].map(f64::from);
    if xy * xy <= xx * yy * (1.0 + COVARIANCE_ROUNDING) {
        return Ok(());
    }
    Err(Place { field, ..place }.out_of_domain(xy, "a covariance that is not above those of xx and yy"))
}
