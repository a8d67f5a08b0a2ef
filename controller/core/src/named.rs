//! Enumerations whose variants have names in counters, messages and files.

/// An enumeration, the list of its variants, and the name of each.
macro_rules! named {
    ($(#[$about:meta])* pub enum $Type:ident { $($(#[$of:meta])* $Variant:ident = $name:literal,)+ }) => {
        $(#[$about])*
        #[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
        pub enum $Type {
            $($(#[$of])* $Variant,)+
        }

        impl $Type {
            /// All variants, in the order of their counters.
            pub const ALL: [Self; [$($name),+].len()] = [$(Self::$Variant),+];

            /// The name in counters, messages and files.
            pub fn name(self) -> &'static str {
                match self {
                    $(Self::$Variant => $name,)+
                }
            }
        }
    };
}

pub(crate) use named;
