//! Drivers from outside: devices, the kit and stops.

mod claim;
mod conformance;
mod devices;
mod direct_commands;
mod servo_board_document;
mod stop_record;
mod stops;
