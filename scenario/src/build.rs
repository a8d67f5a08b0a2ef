//! From file units to the types of the channel.
