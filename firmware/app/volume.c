#include "volume.h"

#include <string.h>

#include "bytes.h"
#include "diskio_card.h"

enum {
    ENTRY = 32,
    ENTRY_NAME = 0, /* 8 + 3 characters */
    ENTRY_ATTRIBUTES = 11,
    ENTRY_CREATED = 14, /* time, date */
    ENTRY_ACCESSED = 18,
    ENTRY_CLUSTER_HIGH = 20,
    ENTRY_WRITTEN = 22,
    ENTRY_CLUSTER_LOW = 26,
    ENTRY_BYTES = 28,
    ATTRIBUTE_VOLUME = 0x08, /* labels, and the parts of long names */
    ATTRIBUTE_DIRECTORY = 0x10,
    ATTRIBUTE_ARCHIVE = 0x20,
    FREE_FROM_HERE = 0x00,
    FREE_ENTRY = 0xE5,
    NUMBER_AT = 3,
    NUMBER_DIGITS = 5,
    KIND_AT = 10,
    SOME_DATE = (2026 - 1980) << 9 | 1 << 5 | 1,
    FSINFO_SECTOR = 1,
    FSINFO_FREE = 488,
    FSINFO_SIGNATURE = 0x61417272,
    FSINFO_SIGNATURE_AT = 484
};

static const uint32_t END_OF_CHAIN = 0x0FFFFFFF, FAT32_MASK = 0x0FFFFFFF;

/* ---- sectors ----
 * FatFs' own sector buffer serves here too: between its calls it is clean, and it is told that it holds nothing. */

static uint8_t *scratch(volume_t *volume)
{
    volume->fs.winsect = (LBA_t)0 - 1;
    return volume->fs.win;
}

static int load(volume_t *volume, uint32_t sector)
{
    return sd_read(volume->card, sector, scratch(volume), 1) == SD_OK ? VOLUME_OK : VOLUME_CARD;
}

static int store(volume_t *volume, uint32_t sector)
{
    return sd_write(volume->card, sector, scratch(volume), 1) == SD_OK ? VOLUME_OK : VOLUME_CARD;
}

int volume_mount(volume_t *volume, sd_card_t *card)
{
    volume->card = card;
    diskio_attach(card);
    const FRESULT result = f_mount(&volume->fs, "", 1);
    if (result == FR_DISK_ERR || result == FR_NOT_READY)
        return VOLUME_CARD;
    const bool is_known = result == FR_OK && (volume->fs.fs_type == FS_FAT16 || volume->fs.fs_type == FS_FAT32);
    return is_known ? VOLUME_OK : VOLUME_UNKNOWN;
}

uint32_t volume_cluster_bytes(const volume_t *volume)
{
    return (uint32_t)volume->fs.csize * SD_SECTOR;
}

static uint32_t cluster_sector(const volume_t *volume, uint32_t cluster)
{
    return volume->fs.database + (cluster - 2) * volume->fs.csize;
}

uint32_t volume_first_sector(const volume_t *volume, const file_t *file)
{
    return cluster_sector(volume, file->first_cluster);
}

static uint32_t clusters_of(const volume_t *volume, uint32_t bytes)
{
    const uint32_t each = volume_cluster_bytes(volume);
    return bytes / each + (bytes % each != 0);
}

/* ---- the allocation table ---- */

static uint32_t entry_bytes(const volume_t *volume)
{
    return volume->fs.fs_type == FS_FAT32 ? 4 : 2;
}

static uint32_t get_link(const volume_t *volume, const uint8_t *sector, uint32_t cluster)
{
    const uint32_t each = entry_bytes(volume);
    const uint8_t *at = sector + cluster * each % SD_SECTOR;
    return each == 4 ? bytes_get_u32(at) & FAT32_MASK : bytes_get_u16(at);
}

static void put_link(const volume_t *volume, uint8_t *sector, uint32_t cluster, uint32_t value)
{
    const uint32_t each = entry_bytes(volume);
    uint8_t *at = sector + cluster * each % SD_SECTOR;
    if (each == 4)
        bytes_put_u32(at, (bytes_get_u32(at) & ~FAT32_MASK) | (value & FAT32_MASK));
    else
        bytes_put_u16(at, (uint16_t)value);
}

static bool is_end(const volume_t *volume, uint32_t link)
{
    return link >= (volume->fs.fs_type == FS_FAT32 ? 0x0FFFFFF8u : 0xFFF8u);
}

static uint32_t table_sector(const volume_t *volume, uint32_t cluster)
{
    return volume->fs.fatbase + cluster * entry_bytes(volume) / SD_SECTOR;
}

/* Store the scratch sector in every copy of the table. */
static int store_copies(volume_t *volume, uint32_t sector)
{
    int result = VOLUME_OK;
    for (uint32_t copy = 0; copy < volume->fs.n_fats && result == VOLUME_OK; copy++)
        result = store(volume, sector + copy * volume->fs.fsize);
    return result;
}

/* Clusters [first, beyond) that are to be a chain up to, not with, `end`, and free from there on. */
typedef struct {
    uint32_t first, end, beyond;
} run_t;

static uint32_t wanted_link(const run_t *run, uint32_t cluster)
{
    if (cluster >= run->end)
        return 0;
    return cluster + 1 == run->end ? END_OF_CHAIN : cluster + 1;
}

/* A sector torn within an entry: the lower bytes are written, the others still those of a free one. */
static bool is_torn(uint32_t link, uint32_t wanted)
{
    return link == (wanted & 0xFF) || link == (wanted & 0xFFFF) || link == (wanted & 0xFFFFFF);
}

static bool is_mine(const volume_t *volume, const run_t *run, uint32_t cluster, uint32_t link)
{
    return link == 0 || link == cluster + 1 || (cluster + 1 == run->beyond && is_end(volume, link)) ||
           is_torn(link, wanted_link(run, cluster));
}

/* Call with each table sector of the run loaded in turn, and the clusters in it. */
typedef int (*run_visitor_t)(volume_t *volume, const run_t *run, uint32_t from, uint32_t to);

static int visit_run(volume_t *volume, const run_t *run, uint32_t from, run_visitor_t visit)
{
    const uint32_t in_sector = SD_SECTOR / entry_bytes(volume);
    int result = VOLUME_OK;
    for (uint32_t cluster = from; cluster < run->beyond && result == VOLUME_OK;) {
        const uint32_t next = (cluster / in_sector + 1) * in_sector;
        const uint32_t to = next < run->beyond ? next : run->beyond;
        result = load(volume, table_sector(volume, cluster));
        if (result == VOLUME_OK)
            result = visit(volume, run, cluster, to);
        cluster = to;
    }
    return result;
}

static int write_part(volume_t *volume, const run_t *run, uint32_t from, uint32_t to)
{
    for (uint32_t cluster = from; cluster < to; cluster++)
        put_link(volume, volume->fs.win, cluster, wanted_link(run, cluster));
    return store_copies(volume, table_sector(volume, from));
}

static int check_part(volume_t *volume, const run_t *run, uint32_t from, uint32_t to)
{
    for (uint32_t cluster = from; cluster < to; cluster++)
        if (!is_mine(volume, run, cluster, get_link(volume, volume->fs.win, cluster)))
            return VOLUME_CONFLICT;
    return VOLUME_OK;
}

static bool is_inside(const volume_t *volume, const run_t *run)
{
    return run->first >= 2 && run->first < run->beyond && run->beyond <= volume->fs.n_fatent;
}

int volume_link(volume_t *volume, const file_t *file)
{
    const uint32_t beyond = file->first_cluster + clusters_of(volume, file->bytes);
    const run_t run = {file->first_cluster, beyond, beyond};
    if (!is_inside(volume, &run))
        return VOLUME_CONFLICT;
    const int result = visit_run(volume, &run, run.first, check_part);
    return result == VOLUME_OK ? visit_run(volume, &run, run.first, write_part) : result;
}

int volume_count_chain(volume_t *volume, const file_t *file, uint32_t *clusters)
{
    uint32_t cluster = file->first_cluster, loaded = 0;
    for (*clusters = 0; cluster >= 2 && cluster < volume->fs.n_fatent; cluster++) {
        const uint32_t sector = table_sector(volume, cluster);
        if (sector != loaded && load(volume, sector) != VOLUME_OK)
            return VOLUME_CARD;
        loaded = sector;
        const uint32_t link = get_link(volume, volume->fs.win, cluster);
        if (!is_end(volume, link) && link != cluster + 1)
            break; /* free, or a chain that jumps: not one of ours */
        ++*clusters;
        if (is_end(volume, link))
            break;
    }
    return VOLUME_OK;
}

/* ---- the count of free clusters, in the FSINFO sector of FAT32 ---- */

static int store_free(volume_t *volume)
{
    if (volume->fs.fs_type != FS_FAT32)
        return VOLUME_OK;
    const uint32_t sector = volume->fs.volbase + FSINFO_SECTOR;
    const int result = load(volume, sector);
    if (result != VOLUME_OK || bytes_get_u32(volume->fs.win + FSINFO_SIGNATURE_AT) != FSINFO_SIGNATURE)
        return result;
    bytes_put_u32(volume->fs.win + FSINFO_FREE, volume->fs.free_clst);
    return store(volume, sector);
}

int volume_count_free(volume_t *volume)
{
    FATFS *fs = &volume->fs;
    DWORD clusters;
    fs->free_clst = 0xFFFFFFFF; /* not known: FatFs counts */
    if (f_getfree("", &clusters, &fs) != FR_OK)
        return VOLUME_CARD;
    volume->fs.fsi_flag &= 0xFE; /* stored here and now */
    return store_free(volume);
}

int volume_note_free(volume_t *volume, int32_t change)
{
    if (volume->fs.free_clst > volume->fs.n_fatent - 2)
        return volume_count_free(volume);
    volume->fs.free_clst += (uint32_t)change;
    return store_free(volume);
}

/* ---- the root directory ---- */

/* Sector `index` of the root directory; VOLUME_NOT_FOUND past its end. `cluster` carries on from call to call. */
static int root_sector(volume_t *volume, uint32_t index, uint32_t *cluster, uint32_t *sector)
{
    const FATFS *fs = &volume->fs;
    if (fs->fs_type != FS_FAT32) {
        *sector = fs->dirbase + index;
        return index < fs->n_rootdir / (SD_SECTOR / ENTRY) ? VOLUME_OK : VOLUME_NOT_FOUND;
    }
    if (index == 0) {
        *cluster = fs->dirbase;
    } else if (index % fs->csize == 0) {
        if (load(volume, table_sector(volume, *cluster)) != VOLUME_OK)
            return VOLUME_CARD;
        *cluster = get_link(volume, fs->win, *cluster);
    }
    if (*cluster < 2 || *cluster >= fs->n_fatent || index >= 65536 / (SD_SECTOR / ENTRY))
        return VOLUME_NOT_FOUND;
    *sector = cluster_sector(volume, *cluster) + index % fs->csize;
    return VOLUME_OK;
}

static bool read_number(const uint8_t *name, uint32_t *number)
{
    *number = 0;
    for (int i = NUMBER_AT; i < NUMBER_AT + NUMBER_DIGITS; i++) {
        if (name[i] < '0' || name[i] > '9')
            return false;
        *number = *number * 10 + (uint32_t)(name[i] - '0');
    }
    return *number != 0;
}

/* LOG and MAG differ in two letters; a cut between them leaves a mixture, which is as good as LOG. */
static bool is_our_prefix(const uint8_t *name)
{
    return (name[0] == 'L' || name[0] == 'M') && (name[1] == 'O' || name[1] == 'A') && name[2] == 'G';
}

static bool read_entry(const uint8_t *entry, file_t *file)
{
    const uint8_t *name = entry + ENTRY_NAME;
    const bool is_kind = name[KIND_AT] == FILE_TEMPORARY || name[KIND_AT] == FILE_SPARE || name[KIND_AT] == FILE_RECORDING;
    if (!is_our_prefix(name) || name[8] != 'K' || name[9] != 'L' || !is_kind || !read_number(name, &file->number))
        return false;
    if (entry[ENTRY_ATTRIBUTES] & (ATTRIBUTE_VOLUME | ATTRIBUTE_DIRECTORY))
        return false;
    file->kind = (file_kind_t)name[KIND_AT];
    file->is_calibration = name[0] == 'M' && name[1] == 'A';
    file->first_cluster = (uint32_t)bytes_get_u16(entry + ENTRY_CLUSTER_HIGH) << 16 | bytes_get_u16(entry + ENTRY_CLUSTER_LOW);
    file->bytes = bytes_get_u32(entry + ENTRY_BYTES);
    return true;
}

/* Look at the entries of the loaded sector. VOLUME_NOT_FOUND: the directory ends here. */
static int visit_sector(volume_t *volume, uint32_t sector, int (*visit)(void *, const file_t *), void *context)
{
    for (uint32_t offset = 0; offset < SD_SECTOR; offset += ENTRY) {
        const uint8_t *entry = volume->fs.win + offset;
        file_t file = {.sector = sector, .offset = (uint16_t)offset};
        if (entry[0] == FREE_FROM_HERE)
            return VOLUME_NOT_FOUND;
        if (entry[0] == FREE_ENTRY || !read_entry(entry, &file))
            continue;
        const int result = visit(context, &file);
        if (result != VOLUME_OK)
            return result;
    }
    return VOLUME_OK;
}

int volume_visit(volume_t *volume, int (*visit)(void *, const file_t *), void *context)
{
    uint32_t cluster = 0, sector = 0;
    int result = VOLUME_OK;
    for (uint32_t index = 0; result == VOLUME_OK; index++) {
        result = root_sector(volume, index, &cluster, &sector);
        if (result == VOLUME_OK)
            result = load(volume, sector);
        if (result == VOLUME_OK)
            result = visit_sector(volume, sector, visit, context);
    }
    return result == VOLUME_NOT_FOUND ? VOLUME_OK : result;
}

/* Find a free entry; its sector is left loaded. */
static int find_free_entry(volume_t *volume, file_t *file)
{
    uint32_t cluster = 0;
    for (uint32_t index = 0;; index++) {
        int result = root_sector(volume, index, &cluster, &file->sector);
        if (result == VOLUME_OK)
            result = load(volume, file->sector);
        if (result != VOLUME_OK)
            return result;
        for (file->offset = 0; file->offset < SD_SECTOR; file->offset += ENTRY) {
            const uint8_t first = volume->fs.win[file->offset];
            if (first == FREE_FROM_HERE || first == FREE_ENTRY)
                return VOLUME_OK;
        }
    }
}

/* Let FatFs make the root directory a cluster longer: by a file that is deleted at once. */
static int grow_root(void)
{
    FIL file;
    if (f_open(&file, "GROW.TMP", FA_CREATE_ALWAYS | FA_WRITE) != FR_OK || f_close(&file) != FR_OK)
        return VOLUME_FULL;
    return f_unlink("GROW.TMP") == FR_OK ? VOLUME_OK : VOLUME_FULL;
}

static void write_name(uint8_t *name, uint32_t number)
{
    memcpy(name, "LOG00000KLT", 11);
    for (int i = NUMBER_AT + NUMBER_DIGITS - 1; number; i--, number /= 10)
        name[i] = (uint8_t)('0' + number % 10);
}

/* All but the first byte of the entry is written while that says "free"; then that byte. */
int volume_create(volume_t *volume, uint32_t number, file_t *file)
{
    int result = find_free_entry(volume, file);
    if (result == VOLUME_NOT_FOUND) {
        result = grow_root();
        if (result == VOLUME_OK)
            result = find_free_entry(volume, file);
    }
    if (result != VOLUME_OK)
        return result == VOLUME_NOT_FOUND ? VOLUME_FULL : result;
    uint8_t *entry = volume->fs.win + file->offset;
    const uint8_t free_mark = entry[0];
    memset(entry, 0, ENTRY);
    write_name(entry + ENTRY_NAME, number);
    const uint8_t first = entry[0];
    entry[0] = free_mark;
    entry[ENTRY_ATTRIBUTES] = ATTRIBUTE_ARCHIVE;
    bytes_put_u16(entry + ENTRY_CREATED + 2, SOME_DATE);
    bytes_put_u16(entry + ENTRY_ACCESSED, SOME_DATE);
    bytes_put_u16(entry + ENTRY_WRITTEN + 2, SOME_DATE);
    result = store(volume, file->sector);
    entry[0] = first;
    if (result == VOLUME_OK)
        result = store(volume, file->sector);
    (void)read_entry(entry, file); /* its own entry: always one of ours */
    return result;
}

/* ---- changes to one entry ---- */

static int load_entry(volume_t *volume, const file_t *file, uint8_t **entry)
{
    *entry = volume->fs.win + file->offset;
    return load(volume, file->sector);
}

int volume_reload(volume_t *volume, const file_t *file, file_t *found)
{
    uint8_t *entry;
    const int result = load_entry(volume, file, &entry);
    *found = *file;
    if (result != VOLUME_OK)
        return result;
    return read_entry(entry, found) ? VOLUME_OK : VOLUME_NOT_FOUND;
}

int volume_set_kind(volume_t *volume, file_t *file, file_kind_t kind)
{
    uint8_t *entry;
    int result = load_entry(volume, file, &entry);
    if (result != VOLUME_OK)
        return result;
    entry[KIND_AT] = (uint8_t)kind;
    file->kind = kind;
    return store(volume, file->sector);
}

int volume_set_calibration(volume_t *volume, file_t *file, bool is_calibration)
{
    uint8_t *entry;
    if (file->is_calibration == is_calibration)
        return VOLUME_OK;
    int result = load_entry(volume, file, &entry);
    if (result != VOLUME_OK)
        return result;
    memcpy(entry, is_calibration ? "MAG" : "LOG", 3);
    file->is_calibration = is_calibration;
    return store(volume, file->sector);
}

int volume_set_size(volume_t *volume, file_t *file, uint32_t bytes)
{
    uint8_t *entry;
    int result = load_entry(volume, file, &entry);
    if (result != VOLUME_OK)
        return result;
    bytes_put_u32(entry + ENTRY_BYTES, bytes);
    if (volume->fat_time)
        bytes_put_u32(entry + ENTRY_WRITTEN, volume->fat_time);
    file->bytes = bytes;
    return store(volume, file->sector);
}

int volume_delete(volume_t *volume, const file_t *file)
{
    uint8_t *entry;
    int result = load_entry(volume, file, &entry);
    if (result != VOLUME_OK)
        return result;
    entry[0] = FREE_ENTRY;
    return store(volume, file->sector);
}

static int set_first_cluster(volume_t *volume, file_t *file, uint32_t cluster)
{
    uint8_t *entry;
    int result = load_entry(volume, file, &entry);
    if (result != VOLUME_OK)
        return result;
    bytes_put_u16(entry + ENTRY_CLUSTER_HIGH, (uint16_t)(cluster >> 16));
    bytes_put_u16(entry + ENTRY_CLUSTER_LOW, (uint16_t)cluster);
    file->first_cluster = cluster;
    return store(volume, file->sector);
}

/* ---- room ---- */

typedef struct {
    uint32_t first, length; /* clusters */
} room_t;

/* The longest free run that ends before `to`, but no longer than wanted. */
static int scan_room(volume_t *volume, uint32_t from, uint32_t to, uint32_t wanted, room_t *best)
{
    const uint32_t in_sector = SD_SECTOR / entry_bytes(volume);
    uint32_t length = 0;
    for (uint32_t cluster = from; cluster < to && best->length < wanted; cluster++) {
        const bool is_next_sector = cluster == from || cluster % in_sector == 0;
        if (is_next_sector && load(volume, table_sector(volume, cluster)) != VOLUME_OK)
            return VOLUME_CARD;
        length = get_link(volume, volume->fs.win, cluster) == 0 ? length + 1 : 0;
        if (length > best->length)
            *best = (room_t){cluster + 1 - length, length};
    }
    return VOLUME_OK;
}

/* Once over the table, from where the last run was found: a full or fragmented card of 32 GB has 8,000 sectors of it, and
 * the watchdog gives a call into the card a minute. */
static int find_room(volume_t *volume, uint32_t wanted, room_t *best)
{
    FATFS *fs = &volume->fs;
    const uint32_t start = fs->last_clst >= 2 && fs->last_clst < fs->n_fatent - 1 ? fs->last_clst + 1 : 2;
    const uint32_t again = start + wanted < fs->n_fatent ? start + wanted : fs->n_fatent; /* a run across the start */
    int result = scan_room(volume, start, fs->n_fatent, wanted, best);
    if (result == VOLUME_OK && best->length < wanted && start > 2)
        result = scan_room(volume, 2, again, wanted, best);
    if (best->length)
        fs->last_clst = best->first - 1;
    return result;
}

/* The cluster first, then the size, of which only one byte is not zero: an entry with a size has its cluster. */
int volume_reserve(volume_t *volume, file_t *file, uint32_t most_bytes, uint32_t step_bytes)
{
    const uint32_t each = volume_cluster_bytes(volume);
    const bool is_count_known = volume->fs.free_clst <= volume->fs.n_fatent - 2;
    room_t room = {0, 0};
    if (is_count_known && volume->fs.free_clst < clusters_of(volume, step_bytes))
        return VOLUME_FULL;
    int result = find_room(volume, clusters_of(volume, most_bytes), &room);
    const uint32_t bytes = room.length * each / step_bytes * step_bytes;
    if (result == VOLUME_OK && bytes == 0)
        return VOLUME_FULL;
    if (result == VOLUME_OK)
        result = set_first_cluster(volume, file, room.first);
    return result == VOLUME_OK ? volume_set_size(volume, file, bytes) : result;
}

/* Whether the chain of the run has been cut before: then the count of free clusters may have been changed, or not. */
static int was_cut(volume_t *volume, const run_t *run, bool *was)
{
    const uint32_t cluster = run->end > run->first ? run->end - 1 : run->first;
    const int result = load(volume, table_sector(volume, cluster));
    if (result == VOLUME_OK) {
        const uint32_t link = get_link(volume, volume->fs.win, cluster);
        *was = link != cluster + 1;
    }
    return result;
}

static int cut_chain(volume_t *volume, const run_t *run)
{
    bool was_cut_before = false;
    int result = was_cut(volume, run, &was_cut_before);
    if (result == VOLUME_OK)
        result = visit_run(volume, run, run->end > run->first ? run->end - 1 : run->first, write_part);
    if (result != VOLUME_OK)
        return result;
    return was_cut_before ? volume_count_free(volume) : volume_note_free(volume, (int32_t)(run->beyond - run->end));
}

int volume_truncate(volume_t *volume, file_t *file, uint32_t bytes)
{
    const run_t run = {file->first_cluster, file->first_cluster + clusters_of(volume, bytes),
                       file->first_cluster + clusters_of(volume, file->bytes)};
    if (!is_inside(volume, &run) || run.end > run.beyond)
        return VOLUME_CONFLICT;
    const int result = run.end < run.beyond ? cut_chain(volume, &run) : VOLUME_OK;
    return result == VOLUME_OK ? volume_set_size(volume, file, bytes) : result;
}
